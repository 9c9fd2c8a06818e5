//! Checkpoints of a node: single states, and journals of the finished pieces of a loop.

use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

use marf_cache::{Digest, digest_of};
use marf_stage::{Ctx, Define, Inputs, StageError};
use serde::{Serialize, de::DeserializeOwned};

/// Wall clock between two checkpoints: what a killed run loses at most. It decides when a state is saved, never what.
pub(crate) const SAVE_EVERY: Duration = Duration::from_secs(10);

/// Begins every part. Its number is raised when a state is written or used otherwise.
const MAGIC: &[u8; 8] = b"marfckp2";

/// Returns the identity of a node's checkpoints: stage, version, parameters, backend, inputs, and `more` that its work depends on.
pub(crate) fn identity<S: Define>(stage: &S, inputs: &Inputs, more: &str) -> Digest {
    let node = (S::NAME, S::VERSION, stage.params().to_string());
    let inputs: BTreeMap<String, Digest> = inputs.0.clone();
    digest_of(&(node, (stage.backend_id(), inputs), more))
}

/// Returns the state of a part, or `None` if it belongs to another identity.
pub(crate) fn load(ctx: &Ctx<'_>, part: &str, of: &Digest) -> Option<Vec<u8>> {
    let bytes = ctx.checkpoints.load(part)?;
    let rest = bytes.strip_prefix(MAGIC)?;
    Some(rest.strip_prefix(of.as_bytes().as_slice())?.to_vec())
}

/// Replaces a part.
pub(crate) fn save(ctx: &Ctx<'_>, part: &str, of: &Digest, state: &[u8]) {
    let bytes = [MAGIC.as_slice(), of.as_bytes(), state].concat();
    ctx.checkpoints.save(part, &bytes);
}

/// The finished pieces of a loop, in order. A loop that was stopped reads them instead of computing them again.
///
/// Pieces are saved in numbered parts, each with those since the last. So the bytes written are proportional to the new pieces.
pub(crate) struct Journal<'a> {
    ctx: &'a Ctx<'a>,
    name: String,
    of: Digest,
    /// Pieces read but not yet returned. `None` when there are no more parts.
    known: Option<VecDeque<Vec<u8>>>,
    /// Pieces returned so far.
    count: u64,
    /// Parts read or written so far.
    parts: u64,
    /// Pieces that are in no part yet.
    fresh: Vec<Vec<u8>>,
    every: Duration,
    saved_at: Instant,
}

impl<'a> Journal<'a> {
    /// Returns the journal of a loop. Within a node, one loop at a time has this name.
    pub fn new(ctx: &'a Ctx<'a>, name: &str, of: Digest) -> Self {
        Self {
            ctx,
            name: name.to_owned(),
            of,
            known: Some(VecDeque::new()),
            count: 0,
            parts: 0,
            fresh: Vec::new(),
            every: SAVE_EVERY,
            saved_at: Instant::now(),
        }
    }

    /// Returns the next piece, which `make` makes unless an earlier run has saved it and `is_whole` takes it.
    ///
    /// Numbers come back to the bit. Types that leave out fields cannot be read back: see [`Journal::piece`].
    ///
    /// # Errors
    /// As [`Journal::piece`].
    pub fn piece_of<T: Serialize + DeserializeOwned>(
        &mut self,
        is_whole: impl Fn(&T) -> bool,
        make: impl FnOnce() -> Result<T, StageError>,
    ) -> Result<T, StageError> {
        self.piece(
            |bytes| postcard::from_bytes(bytes).ok().filter(&is_whole),
            || {
                let piece = make()?;
                let bytes = postcard::to_allocvec(&piece);
                Ok((piece, bytes.map_err(|error| StageError::new(error.to_string()))?))
            },
        )
    }

    /// Returns the next piece. If an earlier run has saved it, `read` decodes its bytes. If there are none or `read` refuses them, `make`
    /// computes the piece and its bytes.
    ///
    /// # Errors
    /// That of `make`. The pieces before it are then saved.
    pub fn piece<T>(
        &mut self,
        mut read: impl FnMut(&[u8]) -> Option<T>,
        make: impl FnOnce() -> Result<(T, Vec<u8>), StageError>,
    ) -> Result<T, StageError> {
        while let Some(bytes) = self.next_known() {
            if let Some(piece) = read(&bytes) {
                self.count += 1;
                return Ok(piece);
            }
            // A later part may begin with this piece: it was then made again.
            self.known = self.known.take().map(|_| VecDeque::new());
        }
        match self.ctx.check().and_then(|()| make()) {
            Ok((piece, bytes)) => {
                self.push(bytes);
                Ok(piece)
            }
            Err(error) => {
                self.save();
                Err(error)
            }
        }
    }

    /// Returns the bytes of the next piece of earlier runs.
    fn next_known(&mut self) -> Option<Vec<u8>> {
        loop {
            let known = self.known.as_mut()?;
            if let Some(piece) = known.pop_front() {
                return Some(piece);
            }
            self.known = self.next_part();
        }
    }

    /// Returns the pieces of the next part from the one that is due on.
    fn next_part(&mut self) -> Option<VecDeque<Vec<u8>>> {
        let state = load(self.ctx, &self.part(), &self.of)?;
        let (first, mut pieces) = postcard::from_bytes::<(u64, VecDeque<Vec<u8>>)>(&state).ok()?;
        let behind = usize::try_from(self.count.checked_sub(first)?).ok()?;
        self.parts += 1;
        pieces.drain(..behind.min(pieces.len()));
        Some(pieces)
    }

    fn part(&self) -> String {
        format!("{}-{}", self.name, self.parts)
    }

    fn push(&mut self, piece: Vec<u8>) {
        self.fresh.push(piece);
        self.count += 1;
        if self.saved_at.elapsed() >= self.every {
            self.save();
        }
    }

    /// Saves the pieces that are in no part: the loop has ended, and longer work follows.
    pub fn end(mut self) {
        self.save();
    }

    /// Saves the pieces that are in no part.
    fn save(&mut self) {
        if !self.fresh.is_empty() {
            let first = self.count - self.fresh.len() as u64;
            // Bytes in memory: it cannot fail.
            let state = postcard::to_allocvec(&(first, &self.fresh)).unwrap_or_default();
            save(self.ctx, &self.part(), &self.of, &state);
            self.parts += 1;
            self.fresh.clear();
        }
        self.saved_at = Instant::now();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_stage::{Checkpoints, harness::Harness};

    const PIECES: u8 = 9;

    /// Runs a loop of nine pieces that ends before piece `stop_at`, and returns which pieces were made.
    fn run(
        harness: &Harness,
        of: &str,
        stop_at: u8,
        every: Duration,
        usable: &dyn Fn(u8) -> bool,
    ) -> Vec<u8> {
        let (ctx, mut made) = (harness.ctx(), Vec::new());
        let mut journal = Journal {
            every,
            ..Journal::new(&ctx, "loop", Digest::from_content(of.as_bytes()))
        };
        for index in 0..PIECES {
            let read = |bytes: &[u8]| bytes.first().copied().filter(|first| usable(*first));
            let piece = journal.piece(read, || {
                if index == stop_at {
                    return Err(StageError::Cancelled);
                }
                made.push(index);
                Ok((index, vec![index; usize::from(index) + 1]))
            });
            match piece {
                Ok(piece) => assert_eq!(piece, index),
                Err(_) => break,
            }
        }
        made
    }

    const NEVER: Duration = Duration::from_secs(1 << 30);

    fn all(_: u8) -> bool {
        true
    }

    #[test]
    fn a_loop_that_is_stopped_anywhere_makes_every_piece_once() {
        for (first, second) in [(0, 1), (1, 2), (1, 8), (4, 4), (5, 6), (8, 8)] {
            let harness = Harness::default();
            let mut made = run(&harness, "a", first, NEVER, &all);
            made.extend(run(&harness, "a", second, NEVER, &all));
            made.extend(run(&harness, "a", PIECES, NEVER, &all));
            assert_eq!(made, (0..PIECES).collect::<Vec<_>>(), "{first} {second}");
        }
    }

    /// A process that is killed cannot save: what was saved by the clock is all there is.
    #[test]
    fn pieces_are_saved_by_the_clock_too_each_once() {
        let harness = Harness::default();
        run(&harness, "a", PIECES, Duration::ZERO, &all);
        let parts: Vec<usize> = (0..PIECES)
            .map(|part| {
                Checkpoints::load(&harness, &format!("loop-{part}"))
                    .unwrap()
                    .len()
            })
            .collect();
        // Magic, digest, number of the first piece, number of pieces and length of the one piece.
        let bytes: Vec<usize> = (1..=usize::from(PIECES))
            .map(|piece| 8 + 32 + 1 + 1 + 1 + piece)
            .collect();
        assert_eq!(parts, bytes);
        assert!(run(&harness, "a", PIECES, NEVER, &all).is_empty());
    }

    #[test]
    fn pieces_of_another_loop_are_not_taken() {
        let harness = Harness::default();
        run(&harness, "a", 5, NEVER, &all);
        assert_eq!(run(&harness, "b", 2, NEVER, &all), [0, 1]);
        // The last parts of `a` are behind the first of `b`.
        assert_eq!(run(&harness, "b", PIECES, NEVER, &all), [2, 3, 4, 5, 6, 7, 8]);
    }

    #[test]
    fn a_damaged_part_costs_only_time() {
        let harness = Harness::default();
        run(&harness, "a", 3, NEVER, &all);
        run(&harness, "a", 6, NEVER, &all);
        let whole = Checkpoints::load(&harness, "loop-1").unwrap();
        for damaged in [&whole[..0], &whole[..39], &whole[..whole.len() - 1], &[7; 100]] {
            Checkpoints::save(&harness, "loop-1", damaged);
            let made = run(&harness, "a", PIECES, NEVER, &all);
            assert!(made == [3, 4, 5, 6, 7, 8], "{} bytes: {made:?}", damaged.len());
        }
    }

    #[test]
    fn a_piece_whose_blobs_are_lost_is_made_again_with_those_behind_it() {
        let harness = Harness::default();
        run(&harness, "a", 2, NEVER, &all);
        run(&harness, "a", 4, NEVER, &all);
        run(&harness, "a", 6, NEVER, &all);
        let without = |lost: u8| move |piece: u8| piece != lost;
        assert_eq!(run(&harness, "a", 6, NEVER, &without(3)), [3, 4, 5]);
        // Piece 3 is in the second and in the fourth part now.
        assert_eq!(run(&harness, "a", PIECES, NEVER, &all), [6, 7, 8]);
    }
}
