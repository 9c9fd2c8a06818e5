use super::*;

mod lengths;

/// The reference values have 12 decimals.
const LAST_DIGIT: f64 = 1e-12;

/// 1 / √1.0002 and such: O of the test cameras, normalised by hand.
fn unit(x: f64, y: f64, z: f64) -> Option<[f64; 3]> {
    let length = (x * x + y * y + z * z).sqrt();
    Some([x / length, y / length, z / length])
}

/// M1 of the reference vectors.
pub(super) fn cahvor() -> Cahvor {
    Cahvor {
        c: [0.8, 0.56, -1.92],
        a: [1.0, 0.0, 0.0],
        h: [823.5, 14_800.0, 0.0],
        v: [599.5, 0.0, 14_800.0],
        o: unit(1.0, 0.01, 0.01),
        r: Some([0.0002, 0.39, 0.035]),
        e: None,
    }
}

/// M2 of the reference vectors for 0, M3 for 0.6.
pub(super) fn cahvore(linearity: f64) -> Cahvor {
    Cahvor {
        c: [0.9, 0.4, -1.9],
        a: [1.0, 0.0, 0.0],
        h: [640.0, 740.0, 0.0],
        v: [480.0, 0.0, 740.0],
        o: unit(1.0, 0.002, -0.001),
        r: Some([0.0, 0.05, -0.017]),
        e: Some(EntrancePupil {
            terms: [-0.0036, 0.013, -0.024],
            linearity,
        }),
    }
}

/// Mastcam-Z left at 110 mm, label of ZLF_1737_0821123689, 1648 x 1200.
pub(super) fn mastcam_z() -> Cahvor {
    Cahvor {
        c: [0.871707, 0.681446, -1.9493],
        a: [-0.407782, 0.568771, 0.714303],
        h: [-12489.0, -7959.55, 295.491],
        v: [5662.13, -8551.97, 10680.9],
        o: Some([-0.408166, 0.55756, 0.722871]),
        r: Some([0.000184038, 0.38818, 0.035168]),
        e: None,
    }
}

/// Navcam left, sol 670, a corner tile of 1288 x 976 of the full frame.
pub(super) fn navcam_tile() -> Cahvor {
    Cahvor {
        c: [0.950849, 0.349753, -1.89429],
        a: [0.824195, 0.0290508, 0.565575],
        h: [2041.23, 3032.24, 1457.63],
        v: [-1646.95, -46.5234, 2456.62],
        o: Some([0.824089, 0.0304646, 0.565654]),
        r: Some([1.736e-6, 0.0501396, -0.0171254]),
        e: Some(EntrancePupil {
            terms: [-8e-9, 1e-8, -2.9e-8],
            linearity: 0.0,
        }),
    }
}

/// Azimuth clockwise from north and elevation, degrees, in a frame with z down.
fn az_el(direction: &Vector3<f64>) -> (f64, f64) {
    let azimuth = direction.y.atan2(direction.x).to_degrees();
    (azimuth.rem_euclid(360.0), -direction.z.asin().to_degrees())
}

fn rotation(w: f64, x: f64, y: f64, z: f64) -> Pose {
    let quaternion = nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
    Pose {
        rotation: *quaternion.to_rotation_matrix().matrix(),
        translation: Vector3::zeros(),
    }
}

/// Numbers in [0, 1) from a linear congruence: the same draws every time.
struct Draws(u64);

impl Draws {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }
}

pub(super) fn near(ours: &[f64], theirs: &[f64], tolerance: f64, what: &str) {
    for (a, b) in ours.iter().zip(theirs) {
        assert!((a - b).abs() <= tolerance, "{what}: {ours:?} is not {theirs:?}");
    }
}

#[test]
fn cahvor_meets_the_reference_vectors() {
    let vectors = [
        (
            [5.8, 0.66, -1.82],
            [1119.541143204844, 895.541143204844],
            [0.99960023984011, 0.019992004796802, 0.019992004796802],
        ),
        (
            [20.8, 1.36, -2.32],
            [1415.900476004331, 303.099523995669],
            [0.99900149750437, 0.039960059900175, -0.019980029950087],
        ),
        (
            [3.8, 0.44, -1.80],
            [230.370502023738, 1192.177698785757],
            [0.99840382978859, -0.039936153191544, 0.039936153191544],
        ),
    ];
    for (point, pixel, direction) in vectors {
        let ours = cahvor().project(&point.into()).unwrap();
        near(ours.as_slice(), &pixel, LAST_DIGIT, "pixel");
        let ray = cahvor().unproject(&ours).unwrap();
        near(ray.direction.as_slice(), &direction, 1e-14, "direction");
        assert_eq!(ray.origin, Vector3::new(0.8, 0.56, -1.92));
    }
}

#[test]
fn cahvore_meets_the_reference_vectors() {
    type Vector = ([f64; 3], [[f64; 2]; 2], [f64; 3], [f64; 3]);
    let vectors: [Vector; 3] = [
        (
            [2.9, 1.9, -0.9],
            [
                [1102.032757047547, 787.731833263130],
                [1135.327674311994, 810.032305922873],
            ],
            [0.89966328628909, 0.39999932657258, -1.8999996632863],
            [0.74283733385394, 0.55703446994223, 0.37135602153317],
        ),
        (
            [1.9, -0.1, -1.2],
            [
                [328.621359393957, 916.140292957841],
                [307.396857700031, 945.778491538403],
            ],
            [0.89971420219513, 0.39999942840439, -1.8999997142022],
            [0.75819037644999, -0.37898644135369, 0.53058140782418],
        ),
        (
            [50.9, 40.4, 8.1],
            [
                [1145.491454557718, 606.210253591606],
                [1177.269269585875, 614.214440083660],
            ],
            [0.89976450710773, 0.39999952901422, -1.8999997645071],
            [0.77151821757336, 0.61721167434692, 0.15430291313614],
        ),
    ];
    for (point, pixels, origin, direction) in vectors {
        for (linearity, pixel) in [0.0, 0.6].into_iter().zip(pixels) {
            let model = cahvore(linearity);
            let ours = model.project(&point.into()).unwrap();
            near(ours.as_slice(), &pixel, LAST_DIGIT, "pixel");
            let ray = model.unproject(&ours).unwrap();
            near(ray.origin.as_slice(), &origin, 1e-13, "origin");
            near(ray.direction.as_slice(), &direction, 1e-13, "direction");
        }
    }
}

#[test]
fn a_mastcam_z_label_agrees_with_its_own_azimuth_and_elevation() {
    let model = mastcam_z().normalised().unwrap();
    let expected = [
        ((0.0, 0.0), (121.423586, -43.825432)),
        ((823.5, 599.5), (125.920389, -46.134571)),
        ((1647.0, 1199.0), (130.791350, -48.251596)),
    ];
    for ((x, y), (azimuth, elevation)) in expected {
        let ray = model.unproject(&Vector2::new(x, y)).unwrap();
        let (az, el) = az_el(&ray.direction);
        near(
            &[az, el],
            &[azimuth, elevation],
            6e-7,
            "az / el in the rover's frame",
        );
    }
    // The label says 126.528 / -46.8053 in the site frame. The inverse rotation would give 125.30 / -45.47.
    let site_from_rover = rotation(0.999907, 0.00148444, 0.00787795, 0.0110686);
    let in_site = model.transformed(&site_from_rover);
    let (az, el) = az_el(&in_site.unproject(&Vector2::new(823.5, 599.5)).unwrap().direction);
    near(
        &[az, el],
        &[126.5280, -46.8053],
        6e-5,
        "az / el in the site frame",
    );
}

#[test]
fn a_curiosity_label_quotes_the_axis() {
    // 2264ML0121141200805116C00_DRCL: FIXED_INSTRUMENT_AZIMUTH 199.1465, FIXED_INSTRUMENT_ELEVATION -56.2743.
    let model = Cahvor {
        c: [0.7820476, 0.4215647, -1.967798],
        a: [0.4654729, -0.1921365, 0.8639552],
        h: [2249.626, 4087.266, 483.6099],
        v: [-3356.067, 1607.817, 2832.301],
        o: None,
        r: None,
        e: None,
    };
    let site_from_rover = rotation(0.3545804, 0.0304361, -0.0007603, -0.9345297);
    let in_site = model.normalised().unwrap().transformed(&site_from_rover);
    let k = in_site.intrinsics().unwrap();
    let axis = in_site.unproject(&Vector2::new(k.hc, k.vc)).unwrap().direction;
    near(
        axis.as_slice(),
        &in_site.a,
        1e-12,
        "the axis meets the image at (hc, vc)",
    );
    let (az, el) = az_el(&axis);
    near(
        &[az, el],
        &[199.1465, -56.2743],
        6e-5,
        "az / el in the site frame",
    );
}

#[test]
fn a_pixel_survives_the_way_to_a_point_and_back() {
    let cameras = [
        cahvor(),
        cahvore(0.0),
        cahvore(0.6),
        cahvore(1.0),
        cahvore(-0.4),
        mastcam_z(),
        navcam_tile(),
    ];
    let mut draws = Draws(7);
    for (index, model) in cameras.into_iter().enumerate() {
        let model = model.normalised().unwrap();
        for _ in 0..4000 {
            let pixel = Vector2::new(draws.next() * 1280.0, draws.next() * 960.0);
            let range_m = 10_f64.powf(draws.next() * 4.3 - 0.3);
            let ray = model.unproject(&pixel).unwrap();
            let back = model.project(&(ray.origin + ray.direction * range_m)).unwrap();
            // The reference closes within 6e-12 px, with f = 14,800 px times 1 ulp of a coordinate of 10 km.
            assert!(
                (back - pixel).amax() < 2e-11,
                "camera {index}, {range_m} m: {pixel} {back}"
            );
        }
    }
}

#[test]
fn behind_the_camera_there_is_no_pixel() {
    // Ten metres behind, w² would hide the sign and put it inside the image.
    let model = mastcam_z().normalised().unwrap();
    let ray = model.unproject(&Vector2::new(940.2, 441.9)).unwrap();
    assert!(model.project(&(ray.origin + ray.direction * 10.0)).is_some());
    assert_eq!(model.project(&(ray.origin - ray.direction * 10.0)), None);
    for camera in [
        cahvore(0.0),
        cahvore(0.6),
        cahvore(1.0),
        Cahvor { o: None, ..cahvor() },
    ] {
        let centre = Vector3::from(camera.c);
        assert_eq!(camera.project(&(centre - Vector3::x() * 3.0)), None, "{camera:?}");
        assert_eq!(camera.project(&centre), None, "{camera:?}");
    }
}

#[test]
fn beyond_the_turning_point_there_is_neither_pixel_nor_ray() {
    // 1 + 3 (-1) chi² = 0 at chi = 0.577, where chi' = 0.385.
    let model = Cahvor {
        o: Some([1.0, 0.0, 0.0]),
        r: Some([0.0, -1.0, 0.0]),
        ..cahvor()
    };
    let point = |chi: f64| Vector3::from(model.c) + Vector3::new(1.0, chi, 0.0);
    assert!(model.project(&point(0.57)).is_some());
    assert_eq!(model.project(&point(0.58)), None);
    let pixel = |chi: f64| Vector2::new(823.5 + 14_800.0 * chi, 599.5);
    assert!(model.unproject(&pixel(0.3848)).is_some());
    assert_eq!(model.unproject(&pixel(0.3851)), None);
    // Just below the turning point plain Newton would jump over it.
    let ray = model.unproject(&pixel(0.384_9)).unwrap();
    let back = model.project(&(ray.origin + ray.direction)).unwrap();
    near(
        back.as_slice(),
        pixel(0.384_9).as_slice(),
        1e-7,
        "near the turning point",
    );
}

#[test]
fn on_the_axis_the_ray_is_the_axis() {
    for model in [cahvor(), cahvore(0.0), cahvore(1.0)] {
        let axis = Vector3::from(model.o.unwrap());
        let pixel = model.project(&(Vector3::from(model.c) + axis * 5.0)).unwrap();
        let ray = model.unproject(&pixel).unwrap();
        near(ray.direction.as_slice(), axis.as_slice(), 1e-12, "axis");
    }
}

#[test]
fn the_linear_part_taken_apart_projects_as_the_model_does() {
    for model in [mastcam_z(), navcam_tile()] {
        let model = Cahvor {
            o: None,
            ..model.normalised().unwrap()
        };
        let k = model.intrinsics().unwrap();
        let along = (1.0 - k.skew * k.skew).sqrt();
        assert!(k.cam_from_frame.is_valid());
        let point =
            Vector3::from(model.c) + model.unproject(&Vector2::new(200.0, 900.0)).unwrap().direction * 7.0;
        let seen = k.cam_from_frame.point(&point);
        let (x, y) = (seen.x / seen.z, seen.y / seen.z);
        let pixel = [k.hs * along * x + k.hs * k.skew * y + k.hc, k.vs * y + k.vc];
        near(&pixel, &[200.0, 900.0], 1e-9, "pixel");
    }
    let k = mastcam_z().normalised().unwrap().intrinsics().unwrap();
    near(&[k.hs], &[14_792.0], 1.0, "focal length of a Mastcam-Z at 110 mm");
    near(&[k.skew.acos().to_degrees()], &[90.0], 0.05, "angle of the axes");
}

#[test]
fn scaling_moves_pixels_as_said() {
    let model = mastcam_z().normalised().unwrap();
    let point =
        Vector3::from(model.c) + model.unproject(&Vector2::new(700.0, 500.0)).unwrap().direction * 9.0;
    // Pixel 700 of a quarter: its centre 700.5 / 4 = 175.125 from the edge, 174.625 from the first centre.
    let binned = model.rescaled(0.25).project(&point).unwrap();
    near(binned.as_slice(), &[174.625, 124.625], 1e-9, "binned by four");
    let eighth = model.rescaled(0.125).project(&point).unwrap();
    near(eighth.as_slice(), &[87.0625, 62.0625], 1e-9, "binned by eight");
    let enlarged = model.rescaled(2.0).project(&point).unwrap();
    near(enlarged.as_slice(), &[1400.5, 1000.5], 1e-9, "enlarged");
}

#[test]
fn moving_the_camera_is_moving_the_point_back() {
    let b_from_a = Pose {
        translation: Vector3::new(254.136, -335.623, -42.4607),
        ..rotation(0.734655, -0.0189704, 0.0529462, -0.676106)
    };
    for model in [mastcam_z(), navcam_tile(), cahvore(0.6)] {
        let model = model.normalised().unwrap();
        let ray = model.unproject(&Vector2::new(300.0, 800.0)).unwrap();
        let point = ray.origin + ray.direction * 4.0;
        let pixel = model
            .transformed(&b_from_a)
            .project(&b_from_a.point(&point))
            .unwrap();
        // Coordinates of 300 m have an ulp of 6e-14 m: 2e-10 px at f = 14,800 px and 4 m.
        near(pixel.as_slice(), &[300.0, 800.0], 1e-8, "pixel");
    }
}

#[test]
fn a_bad_model_is_named_with_its_number() {
    let message = |model: Cahvor| model.normalised().unwrap_err().to_string();
    let nan = message(Cahvor {
        h: [f64::NAN, 0.0, 0.0],
        ..cahvor()
    });
    assert!(nan.contains("not finite: H = [NaN"), "{nan}");
    let infinite = message(Cahvor {
        r: Some([f64::INFINITY, 0.0, 0.0]),
        ..cahvor()
    });
    assert!(infinite.contains("R = [inf"), "{infinite}");
    let long = message(Cahvor {
        a: [1.01, 0.0, 0.0],
        ..cahvor()
    });
    assert!(long.contains("|A| is 1.01"), "{long}");
    let long = message(Cahvor {
        o: Some([0.5, 0.0, 0.0]),
        ..cahvor()
    });
    assert!(long.contains("|O| is 0.5"), "{long}");
    let mirrored = message(Cahvor {
        h: [823.5, -14_800.0, 0.0],
        ..cahvor()
    });
    assert!(mirrored.contains("mirrored"), "{mirrored}");
    let flat = message(Cahvor {
        v: cahvor().h,
        ..cahvor()
    });
    assert!(flat.contains("flat"), "{flat}");
    let wide = message(Cahvor {
        h: [823.5, 200_000.0, 0.0],
        ..cahvor()
    });
    assert!(wide.contains("200000 and 14800 px"), "{wide}");
    let narrow = message(Cahvor {
        h: [0.0; 3],
        ..cahvor()
    });
    assert!(narrow.contains("below 1 px"), "{narrow}");
    let tall = message(Cahvor {
        v: [599.5, 0.0, 130_000.0],
        ..cahvor()
    });
    assert!(tall.contains("14800 and 130000 px"), "{tall}");
    // Axes at 26 degrees: sin 26 = 0.44.
    let sheared = message(Cahvor {
        v: [599.5, 13_300.0, 6_490.0],
        ..cahvor()
    });
    assert!(sheared.contains("4.385e-1 of the product"), "{sheared}");
    assert_eq!(cahvor().project(&Vector3::repeat(f64::NAN)), None);
    assert_eq!(cahvor().unproject(&Vector2::repeat(f64::NAN)), None);
    assert_eq!(cahvore(0.6).project(&Vector3::repeat(f64::INFINITY)), None);
}
