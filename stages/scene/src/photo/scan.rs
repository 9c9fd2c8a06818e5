//! Checks that the scans of a JPEG hold as many blocks as its frame needs.
//!
//! Decoders fill what a scan lacks with grey without an error, if an end marker follows. Hence the Huffman codes are
//! counted here once, without decoding them to pixels (ITU-T T.81, annexes B and F). Progressive, arithmetic and
//! lossless frames are not counted.

use std::cell::OnceCell;

/// Most bytes between the last block and the next marker: none in our photos, but some encoders pad.
const MAX_LEFT_OVER: usize = 2;

/// A fault of a scan.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(super) enum ScanError {
    /// A segment reaches beyond the file, or contradicts another.
    #[error("its segments are damaged at byte {0}")]
    Segment(usize),
    /// A scan has fewer blocks than the frame needs.
    #[error("a scan ends after {has} of {needed} units: it is cut short or damaged")]
    Short {
        /// Units (MCUs) that are complete.
        has: usize,
        /// Units that the frame needs.
        needed: usize,
    },
    /// A scan has more data than blocks.
    #[error("{0} bytes are left over behind the last unit of a scan: it is damaged")]
    LeftOver(usize),
}

/// Returns the position behind the end marker (EOI) of the first picture of a JPEG, or `None` without one.
pub(super) fn end(bytes: &[u8]) -> Option<usize> {
    let mut markers = markers(bytes);
    markers
        .find(|(marker, _)| *marker == 0xd9)
        .map(|(_, start)| start)
}

/// Returns the number of scans of the first picture of a JPEG. The decoder works through all units of the picture for each.
pub(super) fn count(bytes: &[u8]) -> usize {
    let picture = markers(bytes).take_while(|(marker, _)| *marker != 0xd9);
    picture.filter(|(marker, _)| *marker == 0xda).count()
}

/// Returns the markers, and the position behind each.
///
/// Segments are skipped by their length, so that a preview in one of them does not end the picture.
fn markers(bytes: &[u8]) -> impl Iterator<Item = (u8, usize)> {
    let mut at = 2;
    std::iter::from_fn(move || {
        let (marker, start) = next_marker(bytes, at)?;
        at = match marker {
            0x01 | 0xd0..=0xd9 => start,
            // Without its length, this is the last one.
            _ => bytes
                .get(start..)
                .and_then(|rest| rest.first_chunk())
                .map_or(bytes.len(), |length| {
                    start + usize::from(u16::from_be_bytes(*length)).max(2)
                }),
        };
        Some((marker, start))
    })
}

/// Checks that every scan of a baseline JPEG has all its units.
///
/// # Errors
/// See [`ScanError`]. Frames of other kinds are accepted unchecked.
pub(super) fn check(bytes: &[u8]) -> Result<(), ScanError> {
    let mut jpeg = Jpeg::default();
    let mut at = 2;
    loop {
        let (marker, start) = next_marker(bytes, at).ok_or(ScanError::Segment(at))?;
        match marker {
            0xd9 => return Ok(()),
            0x01 | 0xd0..=0xd8 => {
                at = start;
                continue;
            }
            _ => {}
        }
        let length = bytes
            .get(start..start + 2)
            .map_or(0, |two| usize::from(two[0]) << 8 | usize::from(two[1]));
        let body = bytes
            .get(start + 2..start + length)
            .ok_or(ScanError::Segment(start))?;
        at = start + length;
        match marker {
            0xc0 | 0xc1 => jpeg.frame(body).ok_or(ScanError::Segment(start))?,
            0xc4 => jpeg.tables(body).ok_or(ScanError::Segment(start))?,
            0xdd => {
                jpeg.restart = body
                    .get(..2)
                    .map_or(0, |two| usize::from(two[0]) << 8 | usize::from(two[1]))
            }
            0xc2 | 0xc3 | 0xc5..=0xc7 | 0xc9..=0xcb | 0xcd..=0xcf => return Ok(()),
            0xda => {
                let scan = jpeg.scan(body).ok_or(ScanError::Segment(start))?;
                at = scan.count(bytes, at)?;
            }
            _ => {}
        }
    }
}

/// Returns the next marker from `from` on and the position of its segment, or `None` without one.
fn next_marker(bytes: &[u8], from: usize) -> Option<(u8, usize)> {
    let rest = bytes.get(from..)?;
    let is_marker = |pair: &[u8]| pair[0] == 0xff && !matches!(pair[1], 0x00 | 0xff);
    let found = rest.windows(2).position(is_marker)?;
    Some((rest[found + 1], from + found + 2))
}

/// A Huffman table as its segment has it. It is built for the first scan that uses it: a file may have millions.
struct Table<'a> {
    counts: &'a [u8; 16],
    symbols: &'a [u8],
    built: OnceCell<Option<Huffman>>,
}

impl Table<'_> {
    /// Returns the built table, or `None` if it is damaged.
    fn built(&self) -> Option<&Huffman> {
        let built = self.built.get_or_init(|| Huffman::new(self.counts, self.symbols));
        built.as_ref()
    }
}

/// The tables and the frame that were read so far.
#[derive(Default)]
struct Jpeg<'a> {
    /// Huffman tables: DC 0 to 3, then AC 0 to 3.
    tables: [Option<Table<'a>>; 8],
    /// Of each component its id, and its blocks per unit across and down.
    components: Vec<(u8, usize, usize)>,
    width: usize,
    height: usize,
    /// Units between restarts. 0 means no restarts.
    restart: usize,
}

impl<'a> Jpeg<'a> {
    /// Reads a frame header (SOF). `None` if it is damaged.
    fn frame(&mut self, body: &[u8]) -> Option<()> {
        let number = |at: usize| Some(usize::from(*body.get(at)?) << 8 | usize::from(*body.get(at + 1)?));
        (self.height, self.width) = (number(1)?, number(3)?);
        let count = usize::from(*body.get(5)?);
        let parts = body.get(6..6 + 3 * count)?.chunks_exact(3);
        let read = |part: &[u8]| (part[0], usize::from(part[1] >> 4), usize::from(part[1] & 15));
        self.components = parts.map(read).collect();
        let fits = |(_, h, v): &(u8, usize, usize)| (1..=4).contains(h) && (1..=4).contains(v);
        (!self.components.is_empty() && self.components.iter().all(fits) && self.width * self.height > 0)
            .then_some(())
    }

    /// Reads Huffman tables (DHT). `None` if they are cut short.
    fn tables(&mut self, mut body: &'a [u8]) -> Option<()> {
        while let Some((&kind, rest)) = body.split_first() {
            let counts = rest.first_chunk::<16>()?;
            let total: usize = counts.iter().map(|count| usize::from(*count)).sum();
            let symbols = rest.get(16..16 + total)?;
            let place = usize::from(kind >> 4) * 4 + usize::from(kind & 15);
            *self.tables.get_mut(place)? = Some(Table {
                counts,
                symbols,
                built: OnceCell::new(),
            });
            body = &rest[16 + total..];
        }
        Some(())
    }

    /// Reads a scan header (SOS). `None` if it is damaged or names a table that is missing or damaged.
    fn scan(&self, body: &[u8]) -> Option<Scan<'_>> {
        let count = usize::from(*body.first()?);
        let chosen = body.get(1..1 + 2 * count)?.chunks_exact(2);
        let (mut blocks, mut size) = (Vec::new(), (1, 1));
        for pair in chosen {
            let (_, h, v) = *self.components.iter().find(|(id, ..)| *id == pair[0])?;
            let table = |place: usize| self.tables.get(place)?.as_ref()?.built();
            let dc = table(usize::from(pair[1] >> 4) % 4)?;
            let ac = table(4 + usize::from(pair[1] & 15) % 4)?;
            // The unit of a scan of one component is a single block.
            let repeated = if count == 1 { 1 } else { h * v };
            blocks.extend(std::iter::repeat_n((dc, ac), repeated));
            size = (h, v);
        }
        let most = |of: fn(&(u8, usize, usize)) -> usize| self.components.iter().map(of).max();
        let (h, v) = (most(|component| component.1)?, most(|component| component.2)?);
        let units = if count == 1 {
            let own = |side: usize, own: usize, most: usize| (side * own).div_ceil(most).div_ceil(8);
            own(self.width, size.0, h) * own(self.height, size.1, v)
        } else {
            self.width.div_ceil(8 * h) * self.height.div_ceil(8 * v)
        };
        (!blocks.is_empty()).then_some(Scan {
            blocks,
            units,
            restart: self.restart,
        })
    }
}

/// A scan: the DC and AC table of each block of a unit, and how many units it has.
struct Scan<'a> {
    blocks: Vec<(&'a Huffman, &'a Huffman)>,
    units: usize,
    restart: usize,
}

impl Scan<'_> {
    /// Counts the units from `at` on. Returns the position behind the last one.
    fn count(&self, bytes: &[u8], at: usize) -> Result<usize, ScanError> {
        let mut bits = Bits {
            bytes,
            at,
            held: 0,
            count: 0,
        };
        for unit in 0..self.units {
            if self.restart > 0 && unit > 0 && unit % self.restart == 0 {
                bits.restart();
            }
            let whole = self.blocks.iter().all(|(dc, ac)| bits.block(dc, ac).is_some());
            if !whole {
                return Err(ScanError::Short {
                    has: unit,
                    needed: self.units,
                });
            }
        }
        match bits.left_over() {
            left if left > MAX_LEFT_OVER => Err(ScanError::LeftOver(left)),
            _ => Ok(bits.at),
        }
    }
}

/// Bits of the codes that are looked up at once. Longer ones are rare.
const SHORT: u32 = 10;
/// Bits that are looked up at once for several coefficients.
const RUN: u32 = 12;

/// A Huffman table with codes of up to 16 bits.
struct Huffman {
    /// Steps by the next [`SHORT`] bits. Longer codes have none.
    short: Vec<Step>,
    /// Steps by the next 16 bits.
    long: Vec<Step>,
    /// Runs of coefficients by the next [`RUN`] bits.
    runs: Vec<Run>,
}

/// The coefficients (AC) that some bits hold whole, with the numbers behind their codes.
#[derive(Clone, Copy, Default)]
struct Run {
    /// Bits of them all, 0 if not even the first is whole.
    bits: u8,
    /// Places in the block that they take.
    places: u8,
    /// Whether the last one ends the block.
    ends: bool,
}

/// Meaning of a code.
#[derive(Clone, Copy, Default)]
struct Step {
    /// Bits of the code and of the number behind it, whose length is the lower half of the symbol. 0 means that the code is not valid.
    bits: u8,
    /// The symbol: in its upper half, the coefficients that are zero before the number.
    symbol: u8,
}

impl Huffman {
    /// Builds the table from the number of codes of each length and their symbols. `None` if there are too many codes.
    fn new(counts: &[u8; 16], symbols: &[u8]) -> Option<Self> {
        let (mut short, mut long) = (vec![Step::default(); 1 << SHORT], vec![Step::default(); 1 << 16]);
        let (mut next, mut symbols) = (0_usize, symbols.iter());
        for (length, count) in (1_u8..).zip(counts) {
            for _ in 0..*count {
                let span = 1_usize << (16 - length);
                let symbol = *symbols.next()?;
                let step = Step {
                    bits: length + (symbol & 15),
                    symbol,
                };
                long.get_mut(next..next + span)?.fill(step);
                if u32::from(length) <= SHORT {
                    let drop = 16 - SHORT;
                    short[next >> drop..(next + span) >> drop].fill(step);
                }
                next += span;
            }
        }
        let runs = (0..1 << RUN).map(|bits| Run::new(bits, &long)).collect();
        Some(Self { short, long, runs })
    }

    /// Returns the step of the code that left-aligned bits begin with.
    fn step(&self, held: u64) -> Step {
        let step = self.short[(held >> (u64::BITS - SHORT)) as usize];
        if step.bits > 0 {
            return step;
        }
        self.long[(held >> 48) as usize]
    }
}

impl Run {
    /// Reads the coefficients that begin and end in [`RUN`] bits.
    fn new(bits: usize, long: &[Step]) -> Self {
        let mut run = Self::default();
        while u32::from(run.bits) < RUN && !run.ends {
            let step = long[(bits << (16 - RUN) << run.bits) & 0xffff];
            let whole = step.bits > 0 && u32::from(run.bits + step.bits) <= RUN;
            let places = match step.symbol {
                0x00 => 0,
                0xf0 => 16,
                symbol if symbol & 15 == 0 => break,
                symbol => 1 + (symbol >> 4),
            };
            if !whole {
                break;
            }
            run.bits += step.bits;
            run.places += places;
            run.ends = step.symbol == 0;
        }
        run
    }
}

/// A reader of the bits of a scan. It stops at the next marker.
struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
    /// The next bits, left-aligned.
    held: u64,
    count: u32,
}

impl Bits<'_> {
    /// Reads bytes until more than 48 bits are held, or up to the next marker.
    fn fill(&mut self) {
        // Four bytes at once, if no byte of them can begin a marker.
        if let Some(four) = self.bytes.get(self.at..).and_then(|rest| rest.first_chunk::<4>())
            && self.count <= 32
            && !four.contains(&0xff)
        {
            self.held |= u64::from(u32::from_be_bytes(*four)) << (32 - self.count);
            self.at += 4;
            self.count += 32;
        }
        while self.count <= 48 {
            let byte = match (self.bytes.get(self.at), self.bytes.get(self.at + 1)) {
                (Some(0xff), Some(0x00)) => {
                    self.at += 2;
                    0xff
                }
                (Some(0xff) | None, _) => return,
                (Some(byte), _) => {
                    self.at += 1;
                    *byte
                }
            };
            self.held |= u64::from(byte) << (56 - self.count);
            self.count += 8;
        }
    }

    /// Reads a code and skips the number behind it. Returns the symbol.
    fn coefficient(&mut self, table: &Huffman) -> Option<u8> {
        // A code of 16 bits and a number of 15.
        if self.count < 31 {
            self.fill();
        }
        let step = table.step(self.held);
        self.count = self.count.checked_sub(u32::from(step.bits))?;
        self.held <<= step.bits;
        (step.bits > 0).then_some(step.symbol)
    }

    /// Reads one block. `None` if it is incomplete or damaged.
    fn block(&mut self, dc: &Huffman, ac: &Huffman) -> Option<()> {
        self.coefficient(dc)?;
        let mut place = 1;
        while place < 64 {
            if self.count < 31 {
                self.fill();
            }
            // As long as the block goes on behind a run, all of it belongs to the block.
            let run = ac.runs[(self.held >> (u64::BITS - RUN)) as usize];
            let bits = u32::from(run.bits);
            if bits > 0 && bits <= self.count && place + usize::from(run.places) < 64 {
                self.count -= bits;
                self.held <<= bits;
                place += usize::from(run.places);
                if run.ends {
                    return Some(());
                }
                continue;
            }
            match self.coefficient(ac)? {
                0x00 => break,
                0xf0 => place += 16,
                symbol if symbol & 15 == 0 => return None,
                symbol => place += 1 + usize::from(symbol >> 4),
            }
        }
        (place <= 64).then_some(())
    }

    /// Drops the rest of the last byte and skips the restart marker, if there is one, with the fill bytes before it.
    fn restart(&mut self) {
        self.fill();
        (self.held, self.count) = (0, 0);
        if let Some((0xd0..=0xd7, start)) = next_marker(self.bytes, self.at)
            && self.bytes[self.at..start - 1].iter().all(|byte| *byte == 0xff)
        {
            self.at = start;
        }
    }

    /// Returns the number of bytes from here to the next marker that are neither fill bytes (FF) before it nor zeros
    /// throughout, with which some encoders pad.
    fn left_over(&self) -> usize {
        let end = next_marker(self.bytes, self.at).map_or(self.bytes.len(), |(_, start)| start - 2);
        let mut rest = self.bytes.get(self.at..end).unwrap_or_default();
        while let [before @ .., 0xff] = rest {
            rest = before;
        }
        let held = self.count / 8;
        // The whole bytes among the bits that are held.
        let first = self.held << (self.count % 8);
        let is_zero =
            (held == 0 || first >> (u64::BITS - 8 * held) == 0) && rest.iter().all(|byte| *byte == 0);
        if is_zero { 0 } else { rest.len() + held as usize }
    }
}
