//! A covariance that was stopped is gone on with: the matrix with the columns that are factored, then the blocks of the
//! inverse.

use nalgebra::Matrix6;

use super::checkpoint::problem_fingerprint;
use super::problem::Problem;
use crate::Supervisor;
use crate::bytes::{Reader, Writer};
use crate::supervisor::{SAVE_FINISHED, SAVE_UNFINISHED};

/// Forms of both states; a new number where one is written or used otherwise.
const MATRIX: &[u8; 8] = b"covmat01";
const BLOCKS: &[u8; 8] = b"covblk01";

/// The reduced matrix, scaled to a unit diagonal, as far as it is factored.
pub(super) struct ScaledMatrix {
    /// By rows; only the lower triangle is used.
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
    of: u64,
}

impl<'a> Checkpoint<'a> {
    pub fn new(supervisor: &'a dyn Supervisor, problem: &Problem, sigma_px: f64) -> Self {
        Self {
            supervisor,
            of: problem_fingerprint(problem, |writer| writer.number(sigma_px)),
        }
    }

    fn part(&self, what: &str) -> String {
        format!("covariance-{what}-{:016x}", self.of)
    }

    /// Returns the matrix that an earlier run has saved.
    pub fn matrix(&self, n: usize) -> Option<ScaledMatrix> {
        let saved = self.supervisor.load(&self.part("matrix"))?;
        let mut reader = Reader::new(&saved, MATRIX, self.of)?;
        let factored = reader.index()?;
        let scale = reader.list(n, Reader::number)?;
        let least = reader.list(n, Reader::number)?;
        let mut l = vec![0.0; n * n];
        for row in 0..n {
            for value in &mut l[row * n..=row * n + row] {
                *value = reader.number()?;
            }
        }
        reader.end()?;
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
        let due = if factored < n {
            SAVE_UNFINISHED
        } else {
            SAVE_FINISHED
        };
        if factored == 0 || self.supervisor.unsaved_for() < due {
            return;
        }
        let mut writer = Writer::new(MATRIX, self.of);
        writer.reserve(8 * (n * (n + 1) / 2 + 2 * n + 3));
        writer.count(factored as u64);
        for list in [scale, least] {
            writer.list(list, |writer, value| writer.number(*value));
        }
        for row in 0..n {
            matrix[row * n..=row * n + row]
                .iter()
                .for_each(|value| writer.number(*value));
        }
        self.supervisor.save(&self.part("matrix"), &writer.finish());
    }

    /// Returns the first blocks of the inverse, as far as an earlier run has saved them.
    pub fn blocks(&self) -> Vec<Matrix6<f64>> {
        let read = self.supervisor.load(&self.part("blocks")).and_then(|saved| {
            let mut reader = Reader::new(&saved, BLOCKS, self.of)?;
            let blocks = reader.any_list(|reader| {
                let mut block = Matrix6::zeros();
                for value in block.iter_mut() {
                    *value = reader.number()?;
                }
                Some(block)
            })?;
            reader.end()?;
            Some(blocks)
        });
        read.unwrap_or_default()
    }

    /// Saves the first blocks of `all`, now and then.
    pub fn save_blocks(&self, blocks: &[Matrix6<f64>], all: usize) {
        let due = if blocks.len() < all {
            SAVE_UNFINISHED
        } else {
            SAVE_FINISHED
        };
        if self.supervisor.unsaved_for() < due {
            return;
        }
        let mut writer = Writer::new(BLOCKS, self.of);
        writer.list(blocks, |writer, block| {
            block.iter().for_each(|value| writer.number(*value));
        });
        self.supervisor.save(&self.part("blocks"), &writer.finish());
    }
}
