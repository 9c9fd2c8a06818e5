use roxmltree::{Document, Node};

use super::{lens, small, sol_1};
use crate::{
    FlawKind,
    lens::{Lens, Quaternion, rotation_columns},
    math::{self, V3, Vector},
};

/// Reads numbers of a label by the namespace-free names, as the real labels have them.
fn numbers(node: Node<'_, '_>, element: &str) -> Vec<f64> {
    let found = node
        .descendants()
        .find(|node| node.tag_name().name() == element)
        .unwrap();
    let numbers = found
        .children()
        .filter_map(|child| child.text()?.trim().parse().ok());
    numbers.collect()
}

fn labelled(label: &str) -> (Lens, Quaternion, V3) {
    let document = Document::parse(label).unwrap();
    let root = document.root_element();
    let space = root
        .descendants()
        .find(|node| node.tag_name().name() == "Coordinate_Space_Definition")
        .unwrap();
    let v = |element| -> V3 { <[f64; 3]>::try_from(numbers(root, element)).unwrap().into() };
    let lens = Lens {
        c: v("Vector_Center"),
        a: v("Vector_Axis"),
        h: v("Vector_Horizontal"),
        v: v("Vector_Vertical"),
        o: v("Vector_Optical"),
        r: numbers(root, "Radial_Terms").try_into().unwrap(),
    };
    let offset: [f64; 3] = numbers(space, "Vector_Origin_Offset").try_into().unwrap();
    let [w, x, y, z]: [f64; 4] = numbers(space, "Quaternion_Plus_Direction").try_into().unwrap();
    (lens, Quaternion::new(w, x, y, z), offset.into())
}

#[test]
fn labels_tell_a_pose_that_is_a_little_off() {
    for photo in small().ground_truth(1).unwrap().photos {
        let label = std::str::from_utf8(&sol_1()[&format!("{}.xml", &photo.file[..54])]).unwrap();
        let (rover, turn, offset) = labelled(label);
        let site = rover.moved(&rotation_columns(turn), offset);
        let truth = lens(&photo.site_model);
        let turned = (site.a - truth.a)
            .norm()
            .max((site.h.unit() - truth.h.unit()).norm())
            / math::DEGREE;
        let moved = (site.c - truth.c).norm();
        assert!((0.02..0.3).contains(&turned), "{}: {turned} degrees", photo.file);
        assert!((0.001..0.05).contains(&moved), "{}: {moved} m", photo.file);
        // The label states the lens exactly, up to its digits.
        let focal = |lens: &Lens| lens.a.cross(&lens.h).norm();
        assert!((focal(&site) - focal(&truth)).abs() < 1e-5, "{}", photo.file);
        assert!(
            (site.a.dot(&site.h) - truth.a.dot(&truth.h)).abs() < 1e-5,
            "{}",
            photo.file
        );
    }
}

#[test]
fn labels_name_sol_instrument_filter_size_and_counter() {
    for (name, bytes) in sol_1().iter().filter(|(name, _)| name.ends_with(".xml")) {
        let document = Document::parse(std::str::from_utf8(bytes).unwrap()).unwrap();
        let text = |element: &str| {
            let mut nodes = document.descendants();
            nodes
                .find(|node| node.tag_name().name() == element)
                .and_then(|node| node.text())
                .unwrap()
        };
        assert_eq!(text("sol_number"), "1");
        assert_eq!(text("filter_number"), &name[2..3]);
        assert_eq!(text("alternate_id"), &name[..54]);
        assert_eq!(text("samples"), if &name[27..28] == "T" { "40" } else { "160" });
        assert_eq!(text("rotation_direction"), "Forward");
        let elements: Vec<&str> = document
            .descendants()
            .filter(|node| node.tag_name().name() == "elements")
            .filter_map(|node| node.text())
            .collect();
        assert_eq!(elements[2], text("samples"), "{name}");
        let motion = document
            .descendants()
            .filter(|node| node.tag_name().name() == "Motion_Counter_Index");
        assert_eq!(motion.count(), 10);
    }
}

/// A thumbnail's camera must see what the photo's sees: pixel (k, k) of it covers four by four of the photo.
#[test]
fn the_thumbnails_label_is_in_its_own_grid() {
    let truth = small().ground_truth(1).unwrap();
    let flaw = truth
        .flaws
        .iter()
        .find(|flaw| flaw.kind == FlawKind::Thumbnail)
        .unwrap();
    let label = |file: &str| std::str::from_utf8(&sol_1()[&format!("{}.xml", &file[..54])]).unwrap();
    let (large, ..) = labelled(label(flaw.twin.as_ref().unwrap()));
    let (little, ..) = labelled(label(&flaw.file));
    let (x, y) = little.project(large.c + large.ray(41.5, 81.5) * 5.0).unwrap();
    assert!((x - 10.0).abs() < 1e-6 && (y - 20.0).abs() < 1e-6, "{x} {y}");
}
