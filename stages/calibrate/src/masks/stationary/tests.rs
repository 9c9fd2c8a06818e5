use super::*;

const WIDTH: usize = 64;
const HEIGHT: usize = 48;

/// Numbers in 0 to 255 without order.
fn noise(a: usize, b: usize, c: usize) -> f64 {
    let mixed = a
        .wrapping_mul(0x9e37_79b9)
        .wrapping_add(b.wrapping_mul(0x85eb_ca6b))
        ^ c.wrapping_mul(0xc2b2_ae35);
    let mixed = (mixed ^ (mixed >> 15)).wrapping_mul(0x2c1b_3c6d);
    ((mixed ^ (mixed >> 12)) & 255) as f64
}

/// Ground in blocks of 4 pixels that is another in each photo, a plain sky above, and what `hardware` draws.
fn photos(count: usize, hardware: impl Fn(usize, usize) -> Option<f64>) -> Vec<Gray> {
    let photo = |index: usize| {
        let pixel = |at: usize| {
            let (column, row) = (at % WIDTH, at / WIDTH);
            let scene = if row < 12 {
                180.0
            } else {
                noise(column / 4, row / 4, index)
            };
            let exposure = 5.0 * (index % 3) as f64;
            hardware(column, row).unwrap_or(scene) + exposure
        };
        Gray {
            width: WIDTH,
            values: (0..WIDTH * HEIGHT).map(pixel).collect(),
        }
    };
    (0..count).map(photo).collect()
}

fn found(photos: &[Gray]) -> StationaryParts {
    StationaryParts::find(photos, &[false; WIDTH * HEIGHT])
}

fn in_deck(_column: usize, row: usize) -> bool {
    row >= 32
}

fn overlap(found: &[bool], is_planted: impl Fn(usize, usize) -> bool) -> f64 {
    let planted = (0..WIDTH * HEIGHT).map(|at| is_planted(at % WIDTH, at / WIDTH));
    let pairs: Vec<(bool, bool)> = found.iter().copied().zip(planted).collect();
    let both = pairs.iter().filter(|(a, b)| *a && *b).count();
    let any = pairs.iter().filter(|(a, b)| *a || *b).count();
    both as f64 / any.max(1) as f64
}

#[test]
fn a_deck_is_found_whether_it_has_texture_or_only_a_rim() {
    let textured = found(&photos(12, |column, row| {
        in_deck(column, row).then(|| noise(column / 3, row / 3, 99))
    }));
    assert_eq!((textured.pairs, textured.moved), (66, 66));
    assert!(
        overlap(&textured.is_stationary, in_deck) > 0.75,
        "{}",
        overlap(&textured.is_stationary, in_deck)
    );
    let rim = |column: usize, row: usize| {
        let stripes = 250.0 * ((column / 2) % 2) as f64;
        in_deck(column, row).then_some(if row < 35 { stripes } else { 30.0 })
    };
    let plain = found(&photos(12, rim));
    assert!(
        overlap(&plain.is_stationary, in_deck) > 0.75,
        "{}",
        overlap(&plain.is_stationary, in_deck)
    );
}

#[test]
fn neither_a_plain_sky_nor_a_scene_that_changes_is_found() {
    let still = found(&photos(12, |_, _| None));
    assert_eq!((still.moved, still.is_stationary.contains(&true)), (66, false));
}

#[test]
fn a_camera_that_did_not_move_and_few_photos_say_nothing() {
    let one = photos(1, |_, _| None);
    let same = vec![one[0].clone(); 12];
    let still = found(&same);
    assert_eq!((still.moved, still.is_stationary.contains(&true)), (0, false));
    let few = found(&photos(3, |column, row| {
        in_deck(column, row).then(|| noise(column / 3, row / 3, 99))
    }));
    assert!(
        few.moved < LEAST_PAIRS && !few.is_stationary.contains(&true),
        "{few:?}"
    );
    assert!(StationaryParts::find(&[], &[]).is_stationary.is_empty());
    let empty = Gray {
        width: 0,
        values: Vec::new(),
    };
    assert_eq!(StationaryParts::find(&[empty.clone(), empty], &[]).moved, 0);
}

#[test]
fn what_is_hidden_already_is_not_found_again() {
    let photos = photos(12, |column, row| {
        in_deck(column, row).then(|| noise(column / 3, row / 3, 99))
    });
    let known: Vec<bool> = (0..WIDTH * HEIGHT)
        .map(|at| in_deck(at % WIDTH, at / WIDTH))
        .collect();
    let still = StationaryParts::find(&photos, &known);
    assert!(
        still
            .is_stationary
            .iter()
            .zip(&known)
            .all(|(is_stationary, known)| !(*is_stationary && *known))
    );
    assert!(
        still
            .is_stationary
            .iter()
            .filter(|is_stationary| **is_stationary)
            .count()
            < 64,
        "the rim at most"
    );
}

#[test]
fn pairs_are_of_two_photos_and_each_is_there_once() {
    for count in 0..20 {
        let pairs = pairs(count);
        assert!(
            pairs.iter().all(|(one, other)| one < other && *other < count),
            "{count}"
        );
        assert!(pairs.is_sorted() && pairs.windows(2).all(|two| two[0] != two[1]));
        assert_eq!(pairs.is_empty(), count < 2);
    }
}

#[test]
fn closing_joins_what_is_near_and_keeps_what_is_far_apart() {
    let line = |text: &str| text.bytes().map(|byte| byte == b'#').collect::<Vec<bool>>();
    assert_eq!(closed(&line("#..#......#"), 11, 1), line("####......#"));
    assert_eq!(
        without(&line("##.#.###"), 8, |part| part.len() < 2),
        line("##...###")
    );
    assert_eq!(grown_by(&line("...#..."), 7, 2), line(".#####."));
}
