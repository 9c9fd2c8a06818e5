//! A change from a sol on.

use super::*;

/// The view from straight above a place.
#[derive(Debug, PartialEq)]
struct Above {
    /// Height of the ground or of the rock on it, metres.
    height_m: f64,
    /// Its light, linear RGB.
    light: [f64; 3],
    is_shaded: bool,
}

impl Above {
    /// Looks down at a place (x and y in the site frame, metres) on a sol.
    fn new(demo: &Demo, sol: u32, x_m: f64, y_m: f64) -> Self {
        // The landscape has x and y of the site frame, and z up.
        let from_m = 20.0;
        let (from, down) = (math::v3(x_m, y_m, from_m), math::v3(0.0, 0.0, -1.0));
        let seen = demo.world_on(sol).trace(from, down, 1e-4);
        Self {
            height_m: from_m - seen.range_m,
            light: seen.light.into(),
            is_shaded: seen.is_shaded,
        }
    }
}

/// The whole change is what the comparison of two times has to find.
#[test]
fn a_change_is_there_from_its_sol_on_at_its_site_alone() {
    let small = DemoOptions {
        width_px: 32,
        height_px: 24,
        seed: 1,
    };
    let plain = Demo::new(small.clone()).unwrap();
    let demo = Demo::new(small).unwrap().with_change(8).unwrap();
    for (sol, changes) in [(7, false), (8, true), (9, true), (108, false)] {
        let fingerprints = [&plain, &demo].map(|demo| demo.fingerprint(sol).unwrap());
        assert_eq!(fingerprints[0] != fingerprints[1], changes, "sol {sol}");
    }
    let photos = |demo: &Demo, sol: u32| demo.files(sol, &|_, _| (), &|| false).unwrap();
    assert_eq!(photos(&plain, 7), photos(&demo, 7));
    assert_ne!(photos(&plain, 8), photos(&demo, 8));
    let above = |sol: u32, x_m: f64, y_m: f64| Above::new(&demo, sol, x_m, y_m);
    let rise = above(8, 7.25, 1.20).height_m - above(7, 7.25, 1.20).height_m;
    assert!((0.2..0.4).contains(&rise), "{rise}");
    let (before, after) = (above(7, 5.35, 4.3), above(8, 5.35, 4.3));
    assert_eq!(
        (before.height_m, before.is_shaded),
        (after.height_m, after.is_shaded)
    );
    let darker = [0, 1, 2].map(|channel| after.light[channel] / before.light[channel]);
    assert!(
        darker[0] < darker[1] && darker[1] < darker[2] && darker[2] < 1.0,
        "{darker:?}"
    );
    assert_eq!(above(7, 9.5, 4.0), above(8, 9.5, 4.0));
    assert!(Demo::new(DemoOptions::default()).unwrap().with_change(0).is_err());
}
