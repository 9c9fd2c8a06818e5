//! What a software adapter would not show: rules that the text of every kernel keeps.

use super::SHADERS;

/// View numbers are small integers, denormals if they were floats: a driver may flush those to 0.
#[test]
fn no_kernel_reads_a_view_as_a_float() {
    let bound = SHADERS
        .iter()
        .filter(|shader| shader.text.contains("> targets:") || shader.text.contains(" targets: array"));
    let mut found = 0;
    for shader in bound {
        assert!(shader.text.contains("targets: array<Target>"), "{}", shader.name);
        found += 1;
    }
    assert_eq!(found, 3, "rays, compare, exposure_sums");
    assert!(super::TARGET.contains("view: u32"));
}

/// Drivers do not have to clear workgroup memory where Rust does not ask for it, and Rust does not.
#[test]
fn atomics_in_workgroup_memory_are_stored_before_they_are_added_to() {
    for shader in SHADERS {
        for line in shader
            .text
            .lines()
            .filter(|line| line.starts_with("var<workgroup>") && line.contains("atomic"))
        {
            let name = line
                .trim_start_matches("var<workgroup> ")
                .split(':')
                .next()
                .unwrap_or("");
            let text = shader.text;
            let stored = text.find(&format!("atomicStore(&{name}"));
            let used = ["Add", "Max", "Load"].map(|how| text.find(&format!("atomic{how}(&{name}")));
            let first = used.into_iter().flatten().min();
            assert!(stored.is_some() && stored < first, "{}: {name}", shader.name);
        }
    }
}

/// A driver may make a comparison with 0 a maximum, which takes NaN for the smaller: ReLU looks at bits.
#[test]
fn a_relu_looks_at_bits_and_no_kernel_takes_a_maximum_of_floats() {
    let relu = super::DENSITY.shared.concat();
    let body = relu
        .split("fn relu")
        .nth(1)
        .and_then(|rest| rest.split("\n}").next());
    assert!(body.is_some_and(|body| body.contains("bitcast<vec4<u32>>(x)") && !body.contains("0.0) >")));
    for shader in SHADERS {
        let code = shader.source("");
        assert!(!code.contains("max(0.0"), "{}", shader.name);
    }
}
