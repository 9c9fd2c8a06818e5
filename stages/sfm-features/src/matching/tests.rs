use marf_numeric::Rng;

use super::nearest::{ColumnBlocks, NearestTwo, nearest};
use super::*;
use crate::features::{Features, Keypoint};
use crate::simd::InstructionSet;

/// Descriptors of the length that RootSIFT has, 512 or a little less.
fn descriptors(seed: u64, count: usize) -> Vec<[u8; 128]> {
    let mut rng = Rng::new(seed);
    let one = |_| {
        let raw: [f64; 128] = std::array::from_fn(|_| rng.unit_f64() * rng.unit_f64());
        let norm = raw.iter().map(|value| value * value).sum::<f64>().sqrt();
        raw.map(|value| (value / norm * 512.0) as u8)
    };
    (0..count).map(one).collect()
}

fn features(descriptors: Vec<[u8; 128]>) -> Features {
    let keypoint = |index| Keypoint {
        x_px: index as f32,
        y_px: 0.5,
        scale_px: 2.0,
        angle_rad: 0.0,
    };
    Features {
        keypoints: (0..descriptors.len()).map(keypoint).collect(),
        descriptors,
    }
}

/// The definition, one pair of descriptors after the other.
fn plainly(rows: &[[u8; 128]], columns: &[[u8; 128]]) -> Vec<NearestTwo> {
    let dot =
        |a: &[u8; 128], b: &[u8; 128]| a.iter().zip(b).map(|(&a, &b)| i32::from(a) * i32::from(b)).sum();
    let near = |row| {
        let dots: Vec<i32> = columns.iter().map(|column| dot(row, column)).collect();
        let mut order: Vec<usize> = (0..dots.len()).collect();
        order.sort_by_key(|&index| (-dots[index], index));
        NearestTwo {
            best: dots[order[0]],
            second: order.get(1).map_or(0, |&index| dots[index]),
            index: order[0] as u32,
        }
    };
    rows.iter().map(near).collect()
}

#[test]
fn nearest_is_the_definition_on_every_set_and_size() {
    for (rows, columns) in [(1, 1), (1, 40), (40, 1), (7, 15), (8, 16), (9, 17), (65, 130)] {
        let (mut a, b) = (descriptors(1, rows), descriptors(2, columns));
        // Equal descriptors: the tie goes to the lower index.
        a[rows - 1] = a[0];
        for set in InstructionSet::all() {
            let (across, down) = nearest(set, &a, &ColumnBlocks::new(&b));
            assert_eq!(across, plainly(&a, &b), "{set:?} {rows} x {columns}");
            assert_eq!(down, plainly(&b, &a), "{set:?} {rows} x {columns}");
        }
    }
}

#[test]
fn the_greatest_descriptors_do_not_overflow() {
    for byte in [0, 127, 128, 255] {
        let all = vec![[byte; 128]; 20];
        for set in InstructionSet::all() {
            let (across, down) = nearest(set, &all, &ColumnBlocks::new(&all));
            let dot = 128 * i32::from(byte).pow(2);
            let near = NearestTwo {
                best: dot,
                second: dot,
                index: 0,
            };
            assert!(
                across.iter().chain(&down).all(|&found| found == near),
                "{byte} {set:?}"
            );
        }
    }
}

#[test]
fn a_shuffled_copy_is_matched_and_the_other_way_round_too() {
    let a = descriptors(5, 50);
    let mut b = descriptors(6, 30);
    b.extend(a.iter().rev());
    let (a, b) = (features(a), features(b));
    let pairs = match_pair(&a, &b);
    let expected: Vec<[u32; 2]> = (0..50).map(|index| [index, 79 - index]).collect();
    assert_eq!(pairs, expected);
    let mut turned: Vec<[u32; 2]> = match_pair(&b, &a).iter().map(|&[b, a]| [a, b]).collect();
    turned.sort_unstable();
    assert_eq!(turned, expected);
}

#[test]
fn an_ambiguous_or_far_or_missing_descriptor_has_no_match() {
    let a = features(descriptors(7, 1));
    let twice = features([a.descriptors.clone(), a.descriptors.clone()].concat());
    assert_eq!(match_pair(&a, &twice), Vec::<[u32; 2]>::new());
    assert_eq!(match_pair(&twice, &a), Vec::<[u32; 2]>::new());
    assert_eq!(match_pair(&a, &a), [[0, 0]]);
    let black = features(vec![[0; 128]]);
    assert!(match_pair(&black, &black).is_empty());
    assert!(match_pair(&a, &Features::default()).is_empty());
    assert!(match_pair(&Features::default(), &Features::default()).is_empty());
}

#[test]
fn a_keypoint_with_two_orientations_is_one_point() {
    // Features 0 and 1 of both photos stand at one keypoint and match crosswise, 2 stands alone.
    let mut a = features(descriptors(8, 3));
    a.keypoints[1] = a.keypoints[0];
    let mut b = a.clone();
    b.descriptors.swap(0, 1);
    assert_eq!(match_pair(&a, &b), [[0, 0], [2, 2]]);
    // Feature 1 alone matches: it is named by the first feature of its keypoint.
    b.descriptors[0] = [0; 128];
    b.descriptors[1] = [0; 128];
    b.descriptors[0] = a.descriptors[1];
    assert_eq!(match_pair(&a, &b), [[0, 0], [2, 2]]);
}

#[test]
fn sequential_pairs_are_the_next_ones_and_the_powers_of_two() {
    assert_eq!(sequential(0, 3), []);
    assert_eq!(sequential(1, 3), []);
    assert_eq!(sequential(3, 9), exhaustive(3));
    let from_first: Vec<usize> = sequential(40, 3)
        .iter()
        .filter(|pair| pair.0 == 0)
        .map(|pair| pair.1)
        .collect();
    assert_eq!(from_first, [1, 2, 3, 4, 8, 16, 32]);
    assert!(sequential(40, 3).is_sorted());
    // COLMAP's count for 98 photos with powers of two only.
    assert_eq!(sequential(98, 1).len(), 559);
    assert_eq!(exhaustive(98).len(), 4753);
}

fn retrieve(all: &[&Features], per_photo: usize, min_matches: usize) -> Vec<(usize, usize)> {
    let samples = Samples::new(all);
    let matches: Vec<_> = exhaustive(all.len())
        .into_iter()
        .map(|(first, second)| ([first, second], samples.matches(first, second)))
        .collect();
    most_similar(all.len(), &matches, per_photo, min_matches)
}

#[test]
fn photos_that_share_descriptors_are_found() {
    // Photo i shares 20 descriptors with photo i + 1 and none with the others.
    let pool = descriptors(9, 140);
    let photos: Vec<Features> = (0..6)
        .map(|index| features(pool[index * 20..index * 20 + 40].to_vec()))
        .collect();
    let all: Vec<&Features> = photos.iter().collect();
    let chain: Vec<(usize, usize)> = (0..5).map(|index| (index, index + 1)).collect();
    assert_eq!(retrieve(&all, 2, 8), chain);
    assert_eq!(retrieve(&all, 2, 21), []);
    assert_eq!(retrieve(&all, 0, 8), []);
    assert_eq!(retrieve(&[], 2, 8), []);
    // One choice each: 0-1 by 0 and by 1 (tie with 2: the lower), 1-2 by 2, and so on.
    assert_eq!(retrieve(&all, 1, 8), chain);
    assert_eq!(retrieve(&[&Features::default(), all[0]], 2, 0), []);
}
