//! Lengths of vectors and focal lengths as labels round and average them.

use super::*;

#[test]
fn a_h_and_v_are_divided_together() {
    let raw = Cahvor {
        a: [1.0 + 8e-6, 0.0, 0.0],
        o: Some([0.999_9, 0.009_999, 0.009_999]),
        ..cahvor()
    };
    let model = raw.normalised().unwrap();
    let length = |vector: [f64; 3]| Vector3::from(vector).norm();
    assert!((length(model.a) - 1.0).abs() < 1e-15 && (length(model.o.unwrap()) - 1.0).abs() < 1e-15);
    // The pixel of a point, (p.H)/(p.A), must not move.
    let p = Vector3::new(5.0, 0.3, -0.2);
    let column = |model: &Cahvor| p.dot(&Vector3::from(model.h)) / p.dot(&Vector3::from(model.a));
    assert!((column(&model) - column(&raw)).abs() < 1e-9);
    let focal_px = model.intrinsics().unwrap().hs;
    assert!((focal_px - 14_800.0 / (1.0 + 8e-6)).abs() < 1e-9, "{focal_px}");
}

/// A camera whose lines were averaged in pairs, and one of a linearised product.
#[test]
fn unequal_focal_lengths_are_those_of_a_camera() {
    for vertical_px in [7_400.0, 15_900.0, 29_600.0] {
        let unequal = Cahvor {
            v: [599.5, 0.0, vertical_px],
            ..cahvor()
        };
        let k = unequal.normalised().unwrap().intrinsics().unwrap();
        near(&[k.hs, k.vs], &[14_800.0, vertical_px], 1e-9, "focal lengths");
    }
}
