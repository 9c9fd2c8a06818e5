//! A covariance that was stopped is gone on with: the matrix with the columns that are factored, then the blocks of the
//! inverse.

use nalgebra::Matrix6;

use super::problem::Problem;
use crate::Supervisor;
use crate::bytes::{decode, encode, fingerprint};
use crate::supervisor::{SAVE_FINISHED, SAVE_UNFINISHED};

/// Forms of both states. A new number for any change of how one is written or used.
const MATRIX: &[u8; 8] = b"covmat02";
const BLOCKS: &[u8; 8] = b"covblk02";

/// The reduced matrix, scaled to a unit diagonal, as far as it is factored.
pub(super) struct ScaledMatrix {
    /// By rows, only the lower triangle is used.
    pub l: Vec<f64>,
    /// What rows and columns were multiplied by.
    pub scale: Vec<f64>,
    /// Smallest pivots that are taken.
    pub least: Vec<f64>,
    /// Number of factored columns.
    pub factored: usize,
}

/// The checkpoint of one covariance, by the fingerprint of its problem.
pub(super) struct Checkpoint<'a> {
    supervisor: &'a dyn Supervisor,
    fingerprint: u64,
}

/// Number of factored columns, scale, least pivots, and the rows of the lower triangle.
type SavedMatrix = (usize, Vec<f64>, Vec<f64>, Vec<Vec<f64>>);

impl<'a> Checkpoint<'a> {
    pub fn new(supervisor: &'a dyn Supervisor, problem: &Problem, sigma_px: f64) -> Self {
        Self {
            supervisor,
            fingerprint: fingerprint(&(problem, sigma_px)),
        }
    }

    fn part(&self, what: &str) -> String {
        format!("covariance-{what}-{:016x}", self.fingerprint)
    }

    /// Whether to save the state after `done` of `all` parts.
    fn is_due(&self, done: usize, all: usize) -> bool {
        let after = if done < all {
            SAVE_UNFINISHED
        } else {
            SAVE_FINISHED
        };
        self.supervisor.unsaved_for() >= after
    }

    /// Returns the matrix that an earlier run has saved.
    pub fn matrix(&self) -> Option<ScaledMatrix> {
        let saved = self.supervisor.load(&self.part("matrix"))?;
        let (factored, scale, least, rows): SavedMatrix = decode(&saved, MATRIX, self.fingerprint)?;
        drop(saved);
        let n = rows.len();
        let mut l = vec![0.0; n * n];
        for (row, values) in rows.iter().enumerate() {
            l[row * n..=row * n + row].copy_from_slice(values);
        }
        Some(ScaledMatrix {
            l,
            scale,
            least,
            factored,
        })
    }

    /// Saves the matrix with its first columns factored, now and then.
    pub fn save_matrix(&self, matrix: &[f64], scale: &[f64], least: &[f64], factored: usize) {
        let n = scale.len();
        if factored > 0 && self.is_due(factored, n) {
            let rows: Vec<&[f64]> = (0..n).map(|row| &matrix[row * n..=row * n + row]).collect();
            let state = encode(MATRIX, self.fingerprint, &(factored, scale, least, rows));
            self.supervisor.save(&self.part("matrix"), &state);
        }
    }

    /// Returns the first blocks of the inverse, as far as an earlier run has saved them.
    pub fn blocks(&self) -> Vec<Matrix6<f64>> {
        let saved = self.supervisor.load(&self.part("blocks"));
        saved
            .and_then(|saved| decode(&saved, BLOCKS, self.fingerprint))
            .unwrap_or_default()
    }

    /// Saves the first blocks of `all`, now and then.
    pub fn save_blocks(&self, blocks: &[Matrix6<f64>], all: usize) {
        if self.is_due(blocks.len(), all) {
            let state = encode(BLOCKS, self.fingerprint, &blocks);
            self.supervisor.save(&self.part("blocks"), &state);
        }
    }
}
