use super::*;

/// Names of the kernels beyond core WebGPU: they need 64-bit integers and atomic operations on them.
const WIDE: &[&str] = &["scatter_packed"];

fn validated(name: &str, source: &str) -> naga::Module {
    let module = naga::front::wgsl::parse_str(source)
        .unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(source)));
    let mut validator = naga::valid::Validator::new(
        naga::valid::ValidationFlags::all(),
        if WIDE.contains(&name) {
            naga::valid::Capabilities::SHADER_INT64 | naga::valid::Capabilities::SHADER_INT64_ATOMIC_ALL_OPS
        } else {
            naga::valid::Capabilities::empty()
        },
    );
    validator
        .validate(&module)
        .unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(source)));
    module
}

/// Bytes of every struct of a shader, as naga lays it out.
fn spans(module: &naga::Module) -> Vec<(String, usize)> {
    let named = module.types.iter().filter_map(|(_, ty)| match &ty.inner {
        naga::TypeInner::Struct { span, .. } => Some((ty.name.clone()?, *span as usize)),
        _ => None,
    });
    named.collect()
}

/// Every struct of WGSL and its twin in Rust.
const LAYOUTS: &[(&str, usize)] = &[
    ("GridLevel", size_of::<GridLevel>()),
    ("Step", size_of::<Step>()),
    ("ViewCamera", size_of::<ViewCamera>()),
    ("Sighted", size_of::<Sighted>()),
    ("PixelRange", size_of::<PixelRange>()),
    ("Walk", size_of::<Walk>()),
    ("Exposed", size_of::<Exposed>()),
    ("GridPart", size_of::<GridPart>()),
    ("LevelScale", size_of::<LevelScale>()),
    ("Rescaling", size_of::<Rescaling>()),
    ("Rates", size_of::<Rates>()),
    ("Blending", size_of::<Blending>()),
    ("Probing", size_of::<Probing>()),
    ("Filling", size_of::<Filling>()),
    ("Tally", size_of::<Tally>()),
    ("ProductRun", size_of::<ProductRun>()),
    ("TransposeRun", size_of::<TransposeRun>()),
    ("OuterRun", size_of::<OuterRun>()),
    ("SumRun", size_of::<SumRun>()),
    ("AdamNet", size_of::<AdamNet>()),
    ("Pace", size_of::<Pace>()),
    ("HarmonicsRun", size_of::<HarmonicsRun>()),
    ("Extent", size_of::<Extent>()),
    ("GatherRun", size_of::<GatherRun>()),
    ("CompareRun", size_of::<CompareRun>()),
    ("SpreadRun", size_of::<SpreadRun>()),
    ("RunawayRun", size_of::<RunawayRun>()),
    ("Total", size_of::<Total>()),
    ("PaintRun", size_of::<PaintRun>()),
    ("FinishRun", size_of::<FinishRun>()),
    ("Chains", size_of::<Chains>()),
];

#[test]
fn every_kernel_is_valid_core_webgpu_and_its_structs_are_laid_out_as_in_rust() {
    for shader in SHADERS {
        for head in shader.heads {
            let module = validated(shader.name, &shader.source(head));
            for (name, span) in spans(&module) {
                let known = LAYOUTS.iter().find(|(layout, _)| *layout == name);
                assert_eq!(
                    known.map(|(_, bytes)| *bytes),
                    Some(span),
                    "{}: {name}",
                    shader.name
                );
            }
        }
    }
}

#[test]
fn every_file_is_a_kernel_of_the_table_and_begins_with_its_contract() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let files = std::fs::read_dir(folder).unwrap_or_else(|error| panic!("{error}"));
    let mut found = 0;
    for file in files.flatten() {
        let path = file.path();
        if path.extension().is_some_and(|extension| extension == "wgsl") {
            let text = std::fs::read_to_string(&path).unwrap_or_default();
            assert!(SHADERS.iter().any(|shader| shader.text == text), "{path:?}");
            found += 1;
        }
    }
    assert_eq!(found, SHADERS.len());
    for shader in SHADERS {
        for heading in ["Source", "Twin", "Threads", "Reads", "Writes", "Extremes"] {
            let heading = format!("// {heading}");
            assert!(shader.text.contains(&heading), "{}: {heading}", shader.name);
        }
    }
}

/// Integers commute, floats do not: WGSL has no float atomics, and nobody may build one of a compare and exchange.
#[test]
fn no_kernel_adds_floats_in_the_order_of_its_threads() {
    for shader in SHADERS {
        let text = shader.source("");
        for banned in [
            "atomicCompareExchangeWeak",
            "atomic<f32>",
            "atomicExchange",
            "subgroup",
        ] {
            assert!(!text.contains(banned), "{}: {banned}", shader.name);
        }
    }
}
