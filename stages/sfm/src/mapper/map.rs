//! Incremental mapping: models from the view graph.

use super::checkpoint::{PART, fingerprint, is_due};
use super::input::{MIN_PHOTOS, MapError, MapperInput};
use super::merge::merge_last;
use super::model::Model;
use super::register::{Search, Searched};
use super::{initial_pair, lens};
use crate::bytes::{Reader, Writer};
use crate::view_graph::Link;

/// Form of the saved state; a new number where it is written or used otherwise.
const FORM: &[u8; 8] = b"mapping1";

/// Returns the models that the photos form, the largest first.
///
/// A photo is in at most one model; none is forced into one. The result is empty if no pair of photos has both enough
/// matches and enough parallax.
pub fn map(input: &MapperInput<'_>) -> Result<Vec<Model>, MapError> {
    let of = fingerprint(input);
    let mut mapping = Mapping::resume(input, of).unwrap_or_else(|| Mapping::new(input));
    while mapping.step(input)? == Progress::Unfinished {
        if is_due(input)? {
            input.supervisor.save(PART, &mapping.encode(of));
        }
    }
    let mut models = mapping.models;
    models.sort_by_key(|model| (std::cmp::Reverse(model.photos().count()), model.photos().next()));
    Ok(models)
}

/// Everything that is known between two steps.
struct Mapping<'a> {
    models: Vec<Model>,
    /// Whether each photo is in a model, or was left out of one.
    taken: Vec<bool>,
    phase: Phase,
    /// Pairs that the present search may start from; derived from `taken`.
    candidates: Vec<&'a Link>,
}

enum Phase {
    /// Further models are searched for.
    Growing(Box<Search>),
    /// The lens of this model is chosen next.
    Lens(usize),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Progress {
    Unfinished,
    Finished,
}

impl<'a> Mapping<'a> {
    fn new(input: &'a MapperInput<'_>) -> Self {
        let taken = vec![false; input.views.len()];
        Self {
            models: Vec::new(),
            phase: Phase::Growing(Box::default()),
            candidates: initial_pair::candidates(input, &taken),
            taken,
        }
    }

    fn step(&mut self, input: &'a MapperInput<'_>) -> Result<Progress, MapError> {
        match &mut self.phase {
            Phase::Growing(search) => {
                if let Searched::Finished(found) = search.step(input, &self.taken, &self.candidates)? {
                    self.phase = self.add(input, found)?;
                }
            }
            Phase::Lens(index) => {
                let Some(model) = self.models.get_mut(*index) else {
                    return Ok(Progress::Finished);
                };
                lens::choose_lens(input, model)?;
                *index += 1;
            }
        }
        Ok(Progress::Unfinished)
    }

    /// Adds a model to the others and returns what comes next.
    fn add(&mut self, input: &'a MapperInput<'_>, found: Option<Model>) -> Result<Phase, MapError> {
        let fresh = |model: &Model| {
            let photos = model.photos().filter(|&photo| !self.taken[photo]);
            photos.count() >= MIN_PHOTOS.min(input.views.len())
        };
        let Some(model) = found.filter(fresh) else {
            return Ok(Phase::Lens(0));
        };
        for (taken, pose) in self.taken.iter_mut().zip(&model.poses) {
            *taken |= pose.is_some();
        }
        self.models.push(model);
        self.models = merge_last(input, std::mem::take(&mut self.models))?;
        self.candidates = initial_pair::candidates(input, &self.taken);
        Ok(Phase::Growing(Box::default()))
    }

    fn encode(&self, of: u64) -> Vec<u8> {
        let mut writer = Writer::new(FORM, of);
        writer.list(&self.models, |writer, model| model.write(writer));
        writer.flags(&self.taken);
        match &self.phase {
            Phase::Growing(search) => {
                writer.count(0);
                search.write(&mut writer);
            }
            Phase::Lens(index) => {
                writer.count(1);
                writer.count(*index as u64);
            }
        }
        writer.finish()
    }

    /// Returns the state that an unfinished run has saved.
    fn resume(input: &'a MapperInput<'_>, of: u64) -> Option<Self> {
        let saved = input.supervisor.load(PART)?;
        let mut reader = Reader::new(&saved, FORM, of)?;
        let models = reader.any_list(|reader| Model::read(input, reader))?;
        let taken = reader.flags(input.views.len())?;
        let phase = match reader.count()? {
            0 => Phase::Growing(Box::new(Search::read(input, &mut reader)?)),
            1 => Phase::Lens(reader.index()?),
            _ => return None,
        };
        reader.end()?;
        Some(Self {
            models,
            candidates: initial_pair::candidates(input, &taken),
            taken,
            phase,
        })
    }
}
