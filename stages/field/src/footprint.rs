//! How much memory a training takes, known before anything is decoded or trained.

use crate::weights::{NET_ROW, Weights};
use crate::{Config, FieldError, Pixels, Sizes};

/// Bytes of an occupancy cell at an update: density (4), its copy in a checkpoint and in a restored state
/// (8), two lists of the probed quarter, with points (16) and densities (4) (10), seen or not, twice (2).
const CELL_BYTES: u64 = 24;
/// Samples that a network's gradients are kept for at least: 64 rays of 4 samples.
const CHUNK: u64 = 256;
/// A source pixel while its photo is read: file (at most 3), as decoded (4), in three bands (3), as pixels (3), and
/// the photo reduced (at most 3).
const DECODED_PIXEL_BYTES: u64 = 16;
/// A pixel while its view is judged: colour, opacity, depth (20), twice in one band, 8-bit picture and photo
/// (6), PNG of both (6), the photo's decoding.
const JUDGED_PIXEL_BYTES: u64 = DECODED_PIXEL_BYTES + 36;

/// Returns the bytes that a training takes in addition to program and photos, at most.
///
/// With P numbers in tables and networks, each in rows of F: weights, average, two moments and a gradient of
/// 4 bytes each, a count of 4 a row. Twice more all but the gradient, while a checkpoint is packed or read
/// back. For every sample of a batch its place and features, at 4/3 of the samples aimed at, twice for the
/// swings between batches. A gradient of the networks for every chunk of rays. The occupancy.
///
/// Where the scene decides a size, the largest one is counted: the answer is then too high for small scenes.
///
/// # Errors
/// [`FieldError::Config`] where a key is out of its range.
pub fn training_bytes(config: &Config, photos: usize) -> Result<u64, FieldError> {
    config.check()?;
    let (mut state, mut gradient) = (0, 0);
    let mut add = |numbers: u64, row: u64| {
        state += 4 * (4 * numbers + numbers / row);
        gradient += 4 * numbers;
    };
    let features = u64::from(config.features);
    let sizes = Sizes::most(config);
    for shape in Weights::shapes(config, &sizes) {
        add(u64::from(shape.entries) * features, features);
    }
    let networks = network_numbers(config, &sizes);
    add(networks, NET_ROW as u64);
    add(4 * photos as u64, 4);
    let samples = u64::from(config.batch_samples) * 8 / 3;
    let sample = 4 * (u64::from(sizes.levels.value) * features + 6);
    let batch = samples * sample + samples.div_ceil(CHUNK) * 4 * networks;
    let cells = u64::from(config.occupancy_resolution).pow(3);
    Ok(3 * state + gradient + batch + cells * CELL_BYTES)
}

/// Numbers of both networks and the background.
fn network_numbers(config: &Config, sizes: &Sizes) -> u64 {
    // The networks are the same for any table: the smallest is made to count them.
    let mut smallest = sizes.clone();
    smallest.log2_table.value = 8;
    let weights = Weights::zeros(config, &smallest);
    let tensors = weights.tensors();
    let networks = tensors.iter().skip(weights.tables.len());
    networks.map(|(_, values)| values.len() as u64).sum()
}

/// Returns the bytes that one photo takes while it is decoded and shrunk, its file counted in.
pub fn decoding_bytes(width: u32, height: u32) -> u64 {
    Pixels::bytes(width, height, 1, false) / 3 * DECODED_PIXEL_BYTES
}

/// Returns the bytes that a view of that size takes while it is rendered and compared with its photo.
pub fn judging_bytes(width: u32, height: u32) -> u64 {
    Pixels::bytes(width, height, 1, false) / 3 * JUDGED_PIXEL_BYTES
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_training_of_known_size_takes_what_was_counted_by_hand() {
        let config = Config {
            levels: Some(8),
            features: 4,
            log2_table: Some(15),
            finest_resolution: Some(2048),
            batch_samples: 1 << 15,
            ..Config::default()
        };
        // Levels of 16 and 32 cells: 17^3 and 33^3 = 35,937 corners, the second more than 2^15 entries.
        let tables = (4_913 + 7 * 32_768) * 4_u64;
        let networks = 32 * 32 + 32 * 16 + 32 * 32 + 32 * 16 + 48;
        let state = 16 * tables + tables + 16 * networks + networks / 4;
        let batch = 87_381 * 4 * 38 + 342 * 4 * networks;
        let expected = 3 * state + 4 * (tables + networks) + batch + (128_u64.pow(3)) * 24;
        assert_eq!(training_bytes(&config, 0).unwrap(), expected);
        assert_eq!(
            training_bytes(&config, 10).unwrap(),
            expected + 10 * (3 * 68 + 16)
        );
    }

    #[test]
    fn more_of_anything_takes_more() {
        let bytes = |config: &Config| training_bytes(config, 5).unwrap();
        let base = Config::default();
        for more in [
            Config {
                log2_table: Some(23),
                ..base.clone()
            },
            Config {
                levels: Some(16),
                ..base.clone()
            },
            Config {
                color_width: 64,
                ..base.clone()
            },
            Config {
                batch_samples: 1 << 16,
                ..base.clone()
            },
            Config {
                occupancy_resolution: 256,
                ..base.clone()
            },
        ] {
            assert!(bytes(&more) > bytes(&base), "{more:?}");
        }
        let largest = Config {
            levels: Some(16),
            log2_table: Some(24),
            ..base
        };
        assert!(
            (20_000_000_000..80_000_000_000).contains(&bytes(&largest)),
            "{}",
            bytes(&largest)
        );
    }

    #[test]
    fn a_key_out_of_range_is_refused() {
        let config = Config {
            log2_table: Some(40),
            ..Config::default()
        };
        assert!(
            training_bytes(&config, 1)
                .unwrap_err()
                .to_string()
                .contains("log2_table")
        );
    }
}
