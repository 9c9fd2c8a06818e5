//! Incremental mapping: models from the view graph.

use serde::{Deserialize, Serialize};

use super::checkpoint::{PART, fingerprint, is_due};
use super::input::{MIN_PHOTOS, MapError, MapperInput};
use super::merge::merge_last;
use super::model::Model;
use super::register::{Progress, Search, SearchStep};
use super::{initial_pair, lens};
use crate::bytes::{decode, encode};
use crate::view_graph::Link;

/// Form of the saved state. A new number for any change of how it is written or used.
const FORM: &[u8; 8] = b"mapping2";

/// Returns the models that the photos form, the largest first.
///
/// A photo is in at most one model, and may be in none. The result is empty if no pair of photos has both enough
/// matches and enough parallax.
pub fn map(input: &MapperInput<'_>) -> Result<Vec<Model>, MapError> {
    let fingerprint = fingerprint(input);
    let mut mapping = Mapping::resume(input, fingerprint).unwrap_or_else(|| Mapping::new(input));
    while mapping.step(input)? == Progress::Unfinished {
        if is_due(input)? {
            input.supervisor.save(PART, &mapping.encode(fingerprint));
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
    /// Pairs that the present search may start from, derived from `taken`.
    candidates: Vec<&'a Link>,
}

#[derive(Serialize, Deserialize)]
enum Phase {
    /// Further models are searched for.
    Growing(Box<Search>),
    /// The lens of this model is chosen next.
    Lens(usize),
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
                if let SearchStep::Finished(found) = search.step(input, &self.taken, &self.candidates)? {
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

    /// Adds a model to the others and returns the next phase.
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

    /// Returns the state as bytes.
    fn encode(&self, fingerprint: u64) -> Vec<u8> {
        encode(FORM, fingerprint, &(&self.models, &self.taken, &self.phase))
    }

    /// Returns the state that an unfinished run has saved.
    fn resume(input: &'a MapperInput<'_>, fingerprint: u64) -> Option<Self> {
        let saved = input.supervisor.load(PART)?;
        let (models, taken, phase) = decode::<(Vec<Model>, Vec<bool>, Phase)>(&saved, FORM, fingerprint)?;
        Some(Self {
            models,
            candidates: initial_pair::candidates(input, &taken),
            taken,
            phase,
        })
    }
}
