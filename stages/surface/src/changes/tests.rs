//! Planted changes on made maps, and the nodes of each round.

use marf_scene::{Camera, Pose};
use marf_schema::changes::{Change, ChangesParams, Time};
use marf_stage::Sols;
use marf_stage::harness::Harness;
use nalgebra::Vector3;

use super::cells::{Extent, Grid, Values, values};
use super::compare::Comparison;
use super::*;

const CELL_M: f64 = 0.05;
/// Cells of a side of the maps.
const SIDE: u32 = 80;

fn params() -> ChangesParams {
    ChangesParams {
        before: Sols::Ranges(vec![(1, 2)]),
        after: Sols::Ranges(vec![(8, 9)]),
        ..ChangesParams::default()
    }
}

/// Three maps of rolling ground with noise of 5 mm and 2 % of the light, changed by a function of the place (metres).
fn maps(seed: u64, change: &dyn Fn(f64, f64, &mut Values)) -> Vec<Grid> {
    let mut state = seed;
    let mut noise = move || {
        // Numerical Recipes' generator. The sum of four draws is sufficiently normal.
        let mut draw = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / f64::from(1_u32 << 31) - 0.5
        };
        (draw() + draw() + draw() + draw()) * 3.0_f64.sqrt()
    };
    let map = |_| {
        let cell = |place: u32| {
            let x = f64::from(place % SIDE) * CELL_M;
            let y = f64::from(SIDE - place / SIDE) * CELL_M;
            let mut cell = values(0.1 * (x * 1.5).sin() + 0.08 * (y * 2.0).cos(), [160, 120, 90]);
            change(x, y, &mut cell);
            cell[0] += 0.005 * noise();
            (1..4).for_each(|quantity| cell[quantity] += 0.02 * noise());
            Some(cell)
        };
        Grid {
            extent: Extent {
                left: 3,
                top: 7,
                columns: SIDE,
                rows: SIDE,
            },
            cell_m: CELL_M,
            values: (0..SIDE * SIDE).map(cell).collect(),
            spread_m: vec![0.002; (SIDE * SIDE) as usize],
        }
    };
    (0..3).map(map).collect()
}

fn time() -> Time {
    Time {
        sols: vec![1],
        photos: 9,
        psnr: 25.0,
        area_m2: 0.0,
    }
}

fn told(comparison: &Comparison) -> ChangesReport {
    let scene = Scene {
        up: Some([0.0, 0.0, -1.0]),
        metres_per_unit: Some(1.0),
        ..Scene::default()
    };
    let frame = ExportFrame::new(&scene);
    let (axes, _) = frame.metric_map("a test").unwrap();
    comparison.report(&frame, &axes, [time(), time()])
}

fn compared(change: &dyn Fn(f64, f64, &mut Values)) -> ChangesReport {
    let (before, after) = (maps(1, &|_, _, _| {}), maps(99, change));
    let comparison = Comparison::new(&before, &after, &params()).unwrap();
    let report = told(&comparison);
    assert_eq!(drawing::pictures(&comparison, &report).unwrap().len(), 5);
    report
}

/// A square of 1 m.
fn is_inside(x: f64, y: f64) -> bool {
    (1.0..2.0).contains(&x) && (2.0..3.0).contains(&y)
}

#[test]
fn unchanged_ground_shows_no_change_under_other_light_and_a_tilted_frame() {
    let report = compared(&|x, y, cell| {
        cell[0] += 0.03 + 0.01 * x - 0.02 * y;
        cell[1] += 0.3;
        cell[2] -= 0.1;
    });
    assert_eq!(
        (report.patches.len(), report.changed_m2),
        (0, 0.0),
        "{:?}",
        report.patches
    );
    let registration = report.registration;
    // The middle of the map is 2 m from both of its edges.
    assert!(
        (registration.offset_m - (0.03 + 0.02 - 0.04)).abs() < 2e-3,
        "{registration:?}"
    );
    assert!((registration.tilt[0] - 0.01).abs() < 1e-3 && (registration.tilt[1] + 0.02).abs() < 1e-3);
    let gain = [0.3_f64 - 0.1, 0.3, 0.3].map(f64::exp);
    assert!(
        gain.iter()
            .zip(registration.gain)
            .all(|(a, b)| (a - b).abs() < 0.01),
        "{registration:?}"
    );
    assert!(
        (3.5 * 3.5..4.1 * 4.1).contains(&report.compared_m2),
        "{}",
        report.compared_m2
    );
}

#[test]
fn a_planted_stone_and_a_pit_are_found_with_area_height_and_volume() {
    for (rise, change) in [(0.15, Change::Higher), (-0.12, Change::Lower)] {
        let report = compared(&|x, y, cell| cell[0] += if is_inside(x, y) { rise } else { 0.0 });
        let [patch] = report.patches.as_slice() else {
            panic!("{:?}", report.patches)
        };
        assert_eq!(patch.change, change);
        assert!((patch.area_m2 - 1.0).abs() < 0.1, "{patch:?}");
        let [least, most] = patch.area_interval_m2;
        assert!(
            least <= patch.area_m2 && patch.area_m2 <= most && most > 1.0,
            "{patch:?}"
        );
        assert!((patch.height_m[0] - rise).abs() < patch.height_m[1], "{patch:?}");
        assert!((patch.volume_m3 - rise).abs() < 0.1 * rise.abs(), "{patch:?}");
        // Columns begin 3 cells right of the origin. The top row is the 8th above it.
        let middle = [1.5 + 3.5 * CELL_M, 2.5 + (8.0 - 0.5 - 80.0) * CELL_M];
        let off = [0, 1].map(|axis| (patch.middle_m[axis] - middle[axis]).abs());
        assert!(off[0] < CELL_M && off[1] < CELL_M, "{patch:?} {middle:?}");
    }
}

#[test]
fn another_colour_is_a_change_and_a_shadow_is_undecided() {
    let report = compared(&|x, y, cell| {
        if is_inside(x, y) {
            cell[1] -= 0.25;
            cell[2] -= 0.15;
        }
    });
    let kinds: Vec<Change> = report.patches.iter().map(|patch| patch.change).collect();
    assert_eq!(kinds, [Change::Colour]);
    assert!((report.changed_m2 - 1.0).abs() < 0.15, "{:?}", report.patches);
    assert!((report.patches[0].brightness - (-0.25_f64).exp()).abs() < 0.02);
    // A shadow is darker and, under a red sky, redder.
    let shadow = compared(&|x, y, cell| {
        if is_inside(x, y) {
            cell[1] -= 1.2;
            cell[2] += 0.15;
        }
    });
    let kinds: Vec<Change> = shadow.patches.iter().map(|patch| patch.change).collect();
    assert_eq!((kinds, shadow.changed_m2), (vec![Change::Undecided], 0.0));
    assert!((shadow.undecided_m2 - 1.0).abs() < 0.15, "{shadow:?}");
}

/// Of ground that did not change, nine tenths of the changes are inside of the interval that the picture says.
#[test]
fn pictures_of_height_hold_what_their_texts_say() {
    let (before, after) = (
        maps(1, &|_, _, _| {}),
        maps(99, &|x, y, cell| {
            cell[0] += if is_inside(x, y) { 0.15 } else { 0.0 };
        }),
    );
    let comparison = Comparison::new(&before, &after, &params()).unwrap();
    let report = told(&comparison);
    let pictures = drawing::pictures(&comparison, &report).unwrap();
    let has = |png: &[u8], text: &str| png.windows(text.len()).any(|window| window == text.as_bytes());
    let with = |text: &str| {
        let mut found = pictures.iter().map(|(_, png)| png.as_slice());
        found
            .find(|png| has(png, text))
            .unwrap_or_else(|| panic!("no picture says {text}"))
    };
    let heights = with("metres, later less earlier = lowest + (value - 1) * interval; 0: not known");
    let decoder = png::Decoder::new(std::io::Cursor::new(heights))
        .read_info()
        .unwrap();
    let number = |key: &str| -> f64 {
        let mut texts = decoder.info().uncompressed_latin1_text.iter();
        texts
            .find(|chunk| chunk.keyword == key)
            .unwrap()
            .text
            .parse()
            .unwrap()
    };
    let (lowest, step) = (number("marf:height-lowest"), number("marf:height-interval"));
    let values = image::load_from_memory(heights).unwrap().into_luma16().into_raw();
    let change = |index: usize| lowest + (f64::from(values[index]) - 1.0) * step;
    let intervals =
        with("half width of the interval that holds 90 % of the changes of height where nothing changed");
    let intervals = marf_scene::picture::png16::read_quantity(intervals, "height-interval")
        .unwrap()
        .2;
    let width = comparison.extent.columns as usize;
    let (mut risen, mut still, mut inside) = (Vec::new(), 0, 0);
    for index in (0..values.len()).filter(|index| values[*index] > 0) {
        let (column, row) = ((index % width) as f64, (index / width) as f64);
        let left = comparison.extent.left as f64 - 3.0;
        let top = comparison.extent.top as f64 - 7.0;
        let (x, y) = ((column + left) * CELL_M, (f64::from(SIDE) - row + top) * CELL_M);
        if (1.2..1.8).contains(&x) && (2.2..2.8).contains(&y) {
            risen.push(change(index));
        } else if !(0.8..2.2).contains(&x) || !(1.8..3.2).contains(&y) {
            still += 1;
            inside += usize::from(change(index).abs() <= f64::from(intervals[index]));
        }
    }
    let mean = risen.iter().sum::<f64>() / risen.len() as f64;
    assert!((mean - 0.15).abs() < 0.01, "{mean} m of {} cells", risen.len());
    let share = inside as f64 / still as f64;
    // Without noise, nothing changes where nothing was planted.
    assert!(share >= 0.85, "{inside} of {still}");
}

/// Many cells are beyond the limits where little of the change is left, and none of them is reported.
#[test]
fn a_blurred_edge_of_a_colour_lies_where_half_of_the_change_is_left() {
    let share = |x: f64, middle: f64| ((0.5 - (x - middle).abs()) / 0.3 + 0.5).clamp(0.0, 1.0);
    let report = compared(&|x, y, cell| cell[2] -= 0.5 * share(x, 1.5) * share(y, 2.5));
    let [patch] = report.patches.as_slice() else {
        panic!("{:?}", report.patches)
    };
    assert_eq!(patch.change, Change::Colour);
    assert!((patch.area_m2 - 1.0).abs() < 0.08, "{patch:?}");
}

#[test]
fn ground_that_one_time_alone_shows_is_not_compared() {
    let (before, mut after) = (maps(1, &|_, _, _| {}), maps(2, &|_, _, _| {}));
    for map in &mut after {
        map.extent.left += 60;
        // One training alone does not make a cell known.
        map.values[..160].fill(None);
    }
    after[0].values[..160].fill(Some([9.0; 4]));
    let comparison = Comparison::new(&before, &after, &params()).unwrap();
    let report = told(&comparison);
    // Of 20 x 78 cells the edge all around is left out, and the corners within it.
    let compared_m2 = (18.0 * 76.0 - 4.0) * CELL_M * CELL_M;
    assert!((report.compared_m2 - compared_m2).abs() < 1e-9, "{report:?}");
    assert_eq!(report.patches, []);
    for map in &mut after {
        map.extent.left += 18;
    }
    let Err(error) = Comparison::new(&before, &after, &params()) else {
        panic!("two columns are compared")
    };
    assert!(error.to_string().contains("400 are needed"), "{error}");
}

/// Without any scatter the floors hold: nothing is divided by 0.
#[test]
fn equal_maps_have_finite_noise_and_no_change() {
    let flat = |cell: Values| Grid {
        extent: Extent {
            left: 0,
            top: 0,
            columns: 30,
            rows: 30,
        },
        cell_m: CELL_M,
        values: vec![Some(cell); 900],
        spread_m: vec![0.0; 900],
    };
    for cell in [[0.0, -1.0, 0.0, 0.0], [1e6, -6.0, 5.0, -5.0]] {
        let maps = [flat(cell), flat(cell)];
        let comparison = Comparison::new(&maps, &maps, &params()).unwrap();
        let report = told(&comparison);
        assert!(
            report.height.interval > 0.0 && report.height.interval < 0.01,
            "{:?}",
            report.height
        );
        assert_eq!((report.patches.len(), report.registration.offset_m), (0, 0.0));
    }
}

/// One node of the store in the order of rounds: trainings first, surfaces with one cell last.
#[test]
fn rounds_follow_from_what_is_done() {
    let harness = Harness::default();
    let ctx = harness.ctx();
    let setup = ctx.put(b"setup").unwrap();
    let weights = ctx.put(b"weights").unwrap();
    let metrics = ctx.put(b"metrics").unwrap();
    let trained = Outputs::from(
        [("setup", setup), ("weights", weights), ("metrics", metrics)]
            .map(|(name, digest)| (name.to_owned(), digest)),
    );
    let params = ChangesParams {
        cell: Some(0.1),
        ..params()
    };
    let rounds = Rounds {
        params: &params,
        scenes: [ctx.put(b"before").unwrap(), ctx.put(b"after").unwrap()],
    };
    let names = |done: usize| -> Vec<String> {
        let nodes = rounds.next(&ctx, &vec![trained.clone(); done]).unwrap();
        nodes.into_iter().map(|node| node.name).collect()
    };
    assert_eq!(names(0), ["before-train-00", "after-train-00"]);
    let further = [
        "before-train-01",
        "before-train-02",
        "after-train-01",
        "after-train-02",
    ];
    assert_eq!(names(2), further);
    let surfaces = ["surface-00", "surface-01", "surface-02"];
    let expected = ["before", "after"].map(|time| surfaces.map(|name| format!("{time}-{name}")));
    assert_eq!(names(6), expected.concat());
    assert_eq!(names(12), [""; 0]);
    let second = rounds.next(&ctx, &vec![trained.clone(); 2]).unwrap();
    assert_eq!(second[0].inputs.0.get("setup"), Some(&setup));
    assert_eq!(
        (&second[0].params["seed"], &second[3].params["seed"]),
        (&1.into(), &2.into())
    );
    let last = rounds.next(&ctx, &vec![trained; 6]).unwrap();
    assert_eq!(
        (&last[5].params["cell"], &last[5].params["map_cell"]),
        (&0.1.into(), &0.1.into())
    );
    for (name, digest) in [("weights", weights), ("metrics", metrics)] {
        assert_eq!(last[5].inputs.0.get(name), Some(&digest), "{name}");
    }
    assert!(rounds.results(&[]).is_err());
}

/// Sixteen photos in a row, eight a time. `held_out` selects some.
fn two_times(held_out: &dyn Fn(usize) -> bool) -> (Scene, BTreeMap<String, u32>) {
    let frame = |index: usize| Frame {
        id: format!("p{index:02}"),
        file: format!("p{index:02}.png"),
        image: marf_cache::Digest::from_content(&[]),
        mask: None,
        camera: Camera::pinhole(64, 48, 60.0),
        cam_from_world: Pose::looking_at(
            Vector3::new(index as f64, 0.0, 0.0),
            Vector3::new(index as f64, 0.0, 5.0),
            Vector3::y(),
        ),
        held_out: held_out(index),
        error_px: None,
    };
    let scene = Scene {
        frames: (0..16).map(frame).collect(),
        ..Scene::default()
    };
    let sols = scene.frames.iter().enumerate();
    let sols = sols.map(|(index, frame)| (frame.id.clone(), if index < 8 { 1 } else { 8 }));
    let sols = sols.collect();
    (scene, sols)
}

#[test]
fn a_time_none_or_all_of_whose_photos_are_held_out_gets_places_of_its_own() {
    let [before, after] = [Sols::Ranges(vec![(1, 2)]), Sols::Ranges(vec![(8, 9)])];
    let held_out = |part: &Scene| -> Vec<String> {
        let held_out = part.frames.iter().filter(|frame| frame.held_out);
        held_out.map(|frame| frame.id.clone()).collect()
    };
    // All that is held out is of the earlier time.
    let (scene, sols) = two_times(&|index| index == 2 || index == 5);
    assert_eq!(
        held_out(&part(&scene, &sols, &before)),
        ["p02", "p05"],
        "as it was"
    );
    let later = part(&scene, &sols, &after);
    assert!((1..4).contains(&held_out(&later).len()), "{:?}", held_out(&later));
    // All of the later time is held out.
    let (scene, sols) = two_times(&|index| index >= 8);
    for time in [&before, &after] {
        let of_time = held_out(&part(&scene, &sols, time));
        assert!((1..4).contains(&of_time.len()), "{of_time:?}");
    }
}
