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

/// Returns whether a function indexes an array in registers by a number that is not a constant.
fn indexes_registers(module: &naga::Module, function: &naga::Function) -> bool {
    let is_array =
        |ty: naga::Handle<naga::Type>| matches!(module.types[ty].inner, naga::TypeInner::Array { .. });
    let array_at = |mut at| {
        if let naga::Expression::Load { pointer } = function.expressions[at] {
            at = pointer;
        }
        match function.expressions[at] {
            naga::Expression::LocalVariable(local) => is_array(function.local_variables[local].ty),
            naga::Expression::FunctionArgument(index) => is_array(function.arguments[index as usize].ty),
            naga::Expression::CallResult(called) => {
                let result = module.functions[called].result.as_ref();
                result.is_some_and(|result| is_array(result.ty))
            }
            _ => false,
        }
    };
    function
        .expressions
        .iter()
        .any(|(_, expression)| matches!(expression, naga::Expression::Access { base, .. } if array_at(*base)))
}

/// A card keeps an array that a number indexes in memory: networks took two to six times as long.
#[test]
fn kernels_of_networks_index_arrays_of_registers_by_constants() {
    let indexes = |shader: &super::Shader, text: &str| {
        let module = super::tests::validated(shader.name, text);
        let entries = module.entry_points.iter().map(|entry| &entry.function);
        let mut all = module
            .functions
            .iter()
            .map(|(_, function)| function)
            .chain(entries);
        all.any(|function| indexes_registers(&module, function))
    };
    for shader in [super::DENSITY, super::SHADE, super::BACK] {
        for head in shader.heads {
            assert!(!indexes(&shader, &shader.source(head)), "{}", shader.name);
        }
    }
    let text = super::SHADE.source(super::SHADE.heads[0]);
    let spoiled = text.replace("logits[10]", "logits[8u + run.directed]");
    assert!(text != spoiled && indexes(&super::SHADE, &spoiled));
}
