use super::*;

/// Names of the kernels beyond core WebGPU: they need 64-bit integers and atomic operations on them.
const WIDE: &[&str] = &["scatter_packed"];

pub(super) fn validated(name: &str, source: &str) -> naga::Module {
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

/// The type of a field as WGSL spells it.
trait Wgsl {
    const TYPE: &'static str;
}

macro_rules! wgsl {
    ($($rust:ty => $name:literal),* $(,)?) => {
        $(impl Wgsl for $rust {
            const TYPE: &'static str = $name;
        })*
    };
}

wgsl! {
    u32 => "u32",
    i32 => "i32",
    f32 => "f32",
    [u32; 2] => "vec2<u32>",
    [u32; 3] => "vec3<u32>",
    [f32; 2] => "vec2<f32>",
    [f32; 3] => "vec3<f32>",
    [f32; 4] => "vec4<f32>",
    [[u32; 4]; MOST_LAYERS] => "array<vec4<u32>, 6>",
    ViewCamera => "ViewCamera",
}

/// A field: name, type and offset in bytes.
type Field = (String, String, usize);

/// A struct: name, bytes and fields in the order of their offsets.
type Layout = (String, usize, Vec<Field>);

/// Returns a field of Rust as WGSL declares it. Padding is one number a word there: `pad0`, `pad1`.
fn rust_field<S, T: Wgsl>(_: fn(&S) -> &T, name: &str, offset: usize) -> Vec<Field> {
    if name != "pad" {
        return vec![(name.to_owned(), T::TYPE.to_owned(), offset)];
    }
    let scalar = T::TYPE.split(['<', '>']).nth(1).unwrap_or(T::TYPE);
    let words = 0..size_of::<T>() / 4;
    let field = |word: usize| (format!("pad{word}"), scalar.to_owned(), offset + 4 * word);
    words.map(field).collect()
}

/// Returns the layouts of structs. A field that is left out here does not compile.
macro_rules! layouts {
    ($($name:ident { $($field:ident),* })*) => {
        vec![$({
            let _ = |all: $name| {
                let $name { $($field),* } = all;
                $(let _ = $field;)*
            };
            let fields = [$(rust_field(
                |all: &$name| &all.$field,
                stringify!($field),
                std::mem::offset_of!($name, $field),
            )),*];
            (stringify!($name).to_owned(), size_of::<$name>(), fields.concat())
        }),*]
    };
}

/// Returns the layout of every struct that Rust writes or reads.
fn rust_layouts() -> Vec<Layout> {
    layouts! {
        NetsRun { capacity, weights, directed, stride, groups, latents, pad, shapes }
        SumRun { weights, stride, groups, samples, first, behind, pad }
        AdamNet { rows, last, behind, factor, decay, epsilon, beta1, beta2 }
        Pace { rate, total, keep, pad }
        GridLevel { resolution, entries, first, dense }
        Step { seed, number, pixels, observations, share, rays, views, pull, rate, pad }
        ViewCamera { lens, distortion, row_x, row_y, row_z, first, run, width, height, alpha, pad }
        Target { rgb, view, behind, share }
        Observed { pixel, place, share }
        PixelRange { camera, first, count, jitter, pad }
        Walk { rays, ray_slots, capacity, limit, steps, padded, side, resumes, slot, again }
        Exposed { views, offsets, ray_slots, share, limits, decays, epsilon, row }
        GridPart { capacity, slot, level, base }
        LevelScale { scale, quantum, peak, clamped, skip, overflows, first, entries }
        Rescaling { levels, target_bits, most, back_off, lowest, highest, rise, pad }
        Rates { rate, epsilon, decay, beta1, beta2, keep, pad }
        Probing { seed, round, purpose, capacity, first, side, every, offset, empty, factor, phase, slot, pad }
        Filling { cells, parts, capacity, at_mean, decay, unknown, shows, shift, slot }
        Tally { sum, count }
        Extent { slot, capacity, rays, most }
        CompareRun { slot, capacity, rays, views, offsets, behind, pad }
        SpreadRun { slot, capacity, rays, distortion, cell, emptiness, reach, floor }
        Total { visited, kept, rays, alive, faults, loss, pad }
        PaintRun { slot, capacity, rays, deep }
        FinishRun { slot, rays, behind, half_side }
    }
}

/// Returns the type of a field as WGSL spells it. An atomic is the number that it holds.
fn type_name(module: &naga::Module, ty: naga::Handle<naga::Type>) -> String {
    let scalar = |scalar: naga::Scalar| match scalar.kind {
        naga::ScalarKind::Uint => "u32",
        naga::ScalarKind::Sint => "i32",
        naga::ScalarKind::Float => "f32",
        _ => "another kind",
    };
    let ty = &module.types[ty];
    match &ty.inner {
        naga::TypeInner::Scalar(kind) | naga::TypeInner::Atomic(kind) => scalar(*kind).to_owned(),
        naga::TypeInner::Vector { size, scalar: kind } => format!("vec{}<{}>", *size as u32, scalar(*kind)),
        naga::TypeInner::Array {
            base,
            size: naga::ArraySize::Constant(size),
            ..
        } => format!("array<{}, {size}>", type_name(module, *base)),
        _ => ty.name.clone().unwrap_or_else(|| format!("{:?}", ty.inner)),
    }
}

/// Returns the layout of every struct of a shader, as naga lays it out.
fn wgsl_layouts(module: &naga::Module) -> Vec<Layout> {
    let named = module.types.iter().filter_map(|(_, ty)| match &ty.inner {
        naga::TypeInner::Struct { members, span } => {
            let fields = members.iter().map(|member| {
                let name = member.name.clone().unwrap_or_default();
                (name, type_name(module, member.ty), member.offset as usize)
            });
            Some((ty.name.clone()?, *span as usize, fields.collect()))
        }
        _ => None,
    });
    named.collect()
}

/// Names, types and offsets: two numbers of one type that change places in Rust or in WGSL alone fail here.
#[test]
fn every_kernel_is_valid_core_webgpu_and_its_structs_have_the_fields_of_rust() {
    let (known, mut met) = (rust_layouts(), std::collections::BTreeSet::new());
    for shader in SHADERS {
        for head in shader.heads {
            let module = validated(shader.name, &shader.source(head));
            for layout in wgsl_layouts(&module) {
                let rust = known.iter().find(|(name, ..)| *name == layout.0);
                assert_eq!(Some(&layout), rust, "{}: WGSL, then Rust", shader.name);
                met.insert(layout.0);
            }
        }
    }
    for (name, ..) in known {
        assert!(met.contains(&name), "no kernel declares `{name}`");
    }
}

/// The comparison above distinguishes two numbers of one type: here they change places in the text of a
/// kernel.
#[test]
fn two_numbers_that_change_places_in_a_kernel_are_found() {
    let text = SPREAD.source(SPREAD.heads[0]);
    let (before, after) = (
        "distortion: f32,\n    cell: f32,",
        "cell: f32,\n    distortion: f32,",
    );
    assert!(text.contains(before), "{text}");
    let known = rust_layouts();
    let is_known = |text: &str| {
        let layouts = wgsl_layouts(&validated("spread", text));
        layouts.iter().all(|layout| known.contains(layout))
    };
    assert!(is_known(&text) && !is_known(&text.replace(before, after)));
}

/// A struct is declared in one file. Two kinds of kernels see the marks of a level, with and without atomics.
#[test]
fn every_struct_is_declared_once() {
    let mut texts: Vec<&str> = SHADERS
        .iter()
        .flat_map(|shader| shader.shared.iter().copied().chain([shader.text]))
        .filter(|text| *text != LEVEL_MARKS)
        .collect();
    texts.sort_unstable();
    texts.dedup();
    for (name, ..) in rust_layouts() {
        let declared = format!("struct {name} {{");
        let times: usize = texts.iter().map(|text| text.matches(&declared).count()).sum();
        assert_eq!(times, 1, "`{name}` is declared {times} times");
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

/// Integers commute, floats do not: WGSL has no float atomics, and none may be built with compare and
/// exchange.
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
