use std::convert::Infallible;

use proptest::prelude::*;

use super::tables::{MAX_RADIUS, hash_of, keys_of, ones_by_four, others, sum_of_fours};
use super::*;

/// Returns hashes, some near those before them.
fn hashes() -> impl Strategy<Value = Vec<u64>> {
    let drawn = proptest::collection::vec((any::<u64>(), any::<u64>(), 0_u8..5), 1..60);
    drawn.prop_map(|drawn| {
        let mut hashes: Vec<u64> = Vec::new();
        for (hash, flips, kind) in drawn {
            let last = hashes.last().copied().unwrap_or(hash);
            hashes.push(match kind {
                0 => hash,
                1 => last,
                2 => last ^ (1 << (flips % 64)),
                // A few bits, and many.
                3 => last ^ (flips & (flips >> 20) & (flips >> 40)),
                _ => last ^ (flips & (flips >> 13)),
            });
        }
        hashes
    })
}

/// An index with tables, however few hashes it has.
fn with_tables(search: Search, hashes: &[u64]) -> HashIndex {
    let mut tables = Tables::new(search);
    for (position, hash) in (0..).zip(hashes) {
        tables.insert(*hash, position);
    }
    HashIndex {
        search,
        all: Vec::new(),
        tables: Some(tables),
    }
}

fn found(index: &HashIndex, hash: u64) -> Vec<u32> {
    let mut found = Vec::new();
    index.find_within(hash, &mut found);
    found.sort_unstable();
    found.dedup();
    found
}

/// Returns the results of a search for many hashes at once.
fn found_together(index: &HashIndex, hashes: &[u64]) -> Vec<Vec<u32>> {
    let numbered: Vec<(u32, u64)> = (0..).zip(hashes.iter().copied()).collect();
    let mut found = vec![Vec::new(); hashes.len()];
    index.find_within_many(&numbered, |number, position| {
        found[number as usize].push(position);
        true
    });
    for positions in &mut found {
        positions.sort_unstable();
        positions.dedup();
    }
    found
}

fn scanned(hashes: &[u64], hash: u64, radius: u32) -> Vec<u32> {
    let near = (0..)
        .zip(hashes)
        .filter(|(_, other)| (hash ^ **other).count_ones() <= radius);
    near.map(|(position, _)| position).collect()
}

/// Returns the first hash that is accepted, and how far it is.
fn nearest(index: &HashIndex, hash: u64, accept: impl Fn(u32) -> bool) -> Option<(u32, u32)> {
    let mut found = None;
    let asked: Result<(), Infallible> = index.find_nearest(hash, |distance, position| {
        found = accept(position).then_some((distance, position));
        Ok(found.is_some())
    });
    asked.unwrap();
    found
}

proptest! {
    #[test]
    fn tables_find_what_comparing_all_finds(hashes in hashes(), radius in prop_oneof![Just(0), Just(1), Just(3), Just(14), Just(18), Just(64), 0_u32..20]) {
        let index = with_tables(Search::Within(radius), &hashes);
        let mut growing = HashIndex::new(Search::Within(radius));
        for (position, hash) in (0..).zip(&hashes) {
            growing.insert(*hash, position);
        }
        for hash in &hashes {
            let expected = scanned(&hashes, *hash, radius);
            prop_assert_eq!(&found(&growing, *hash), &expected);
            if radius <= MAX_RADIUS {
                prop_assert_eq!(&found(&index, *hash), &expected);
            }
        }
    }

    #[test]
    fn the_nearest_is_the_nearest_and_of_equals_the_first(hashes in hashes(), hash in any::<u64>(), skip in 1_u32..4) {
        let accept = |position: u32| position.is_multiple_of(skip);
        let mut growing = HashIndex::new(Search::Nearest);
        for (position, hash) in (0..).zip(&hashes) {
            growing.insert(*hash, position);
        }
        let tables = with_tables(Search::Nearest, &hashes);
        for hash in hashes.iter().copied().chain([hash]) {
            let all = (0_u32..).zip(&hashes).filter(|(position, _)| accept(*position));
            let expected = all.map(|(position, other)| ((hash ^ other).count_ones(), position)).min();
            prop_assert_eq!(nearest(&growing, hash, accept), expected);
            prop_assert_eq!(nearest(&tables, hash, accept), expected);
        }
        prop_assert_eq!(nearest(&tables, hash, |_| false), None);
    }

    #[test]
    fn keys_hold_every_bit_once(hash in any::<u64>()) {
        let keys = keys_of(hash);
        prop_assert_eq!(keys.iter().map(|key| key.count_ones()).sum::<u32>(), hash.count_ones());
        for key in 0..KEYS {
            prop_assert_eq!(hash_of(key, keys[key], &others(&keys, key)), hash);
            let by_four = others(&keys, key).map(|word| ones_by_four(word) as i16);
            let sum = by_four.into_iter().fold(0, i16::wrapping_add);
            prop_assert_eq!(sum_of_fours(sum) as u32, hash.count_ones() - keys[key].count_ones());
        }
    }
}

/// 500 hashes within 12 bits of one another, among as many as make the index change from comparing all to tables.
#[test]
fn a_cluster_of_500_is_found_whole_before_and_after_tables_are_made() {
    let mut state = 7_u64;
    let mut draw = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        state ^ (state >> 29)
    };
    let centre = draw();
    let mut hashes: Vec<u64> = Vec::new();
    while hashes.len() < FEW + 2_000 {
        let near = (0..6).fold(centre, |hash, _| hash ^ (1 << (draw() >> 58)));
        hashes.push(if hashes.len().is_multiple_of(16) {
            near
        } else {
            draw()
        });
    }
    for radius in [0, 14, 64] {
        let mut index = HashIndex::new(Search::Within(radius));
        for (position, hash) in (0..).zip(&hashes) {
            index.insert(*hash, position);
            if [100, FEW as u32 - 1, FEW as u32 + 1, hashes.len() as u32 - 1].contains(&position) {
                let inserted = &hashes[..=position as usize];
                assert_eq!(
                    found(&index, centre),
                    scanned(inserted, centre, radius),
                    "{radius} {position}"
                );
            }
        }
        assert_eq!(index.tables.is_some(), radius <= MAX_RADIUS);
        let asked = &hashes[..MANY + 30];
        let expected: Vec<_> = asked.iter().map(|hash| scanned(&hashes, *hash, radius)).collect();
        assert_eq!(found_together(&index, asked), expected, "{radius}");
        let mut left = 3;
        index.find_within_many(&(0..).zip(asked.iter().copied()).collect::<Vec<_>>(), |_, _| {
            left -= 1;
            left > 0
        });
        assert_eq!(left, 0, "it continues after a request to stop");
    }
}
