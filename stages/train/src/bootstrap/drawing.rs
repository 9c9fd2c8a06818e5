use marf_scene::{
    Image, Srgb,
    picture::{ColorScale, Palette, draw_map, draw_titled, round_upper_limit, side_by_side},
};
use marf_schema::{bootstrap::Shown, output::MAPS};
use marf_stage::{Ctx, Outputs, StageError, TypedOutputs};

use super::{maps::Maps, npy::encode_npy, report::ViewMaps};
use crate::io::put_png;

/// Share of the pixels that a scale reaches; what lies above has the top colour, and the label says so.
const REACH: f64 = 0.995;

/// Colour scales of all maps, one for each quantity, so that viewpoints can be compared.
#[derive(Debug)]
pub(crate) struct Scales {
    std: ColorScale,
    opacity: ColorScale,
    total: ColorScale,
    depth: ColorScale,
    depth_std: ColorScale,
    error: ColorScale,
}

impl Scales {
    /// Returns scales that reach the largest values of all views.
    pub fn of(views: &[ViewMaps], metres_per_unit: Option<f64>) -> Self {
        let scale = |title: &str, unit: &str, high: f64| ColorScale {
            title: title.to_owned(),
            unit: unit.to_owned(),
            low: 0.0,
            high,
            palette: Palette::Inferno,
        };
        let top = |map: &dyn Fn(&ViewMaps) -> Vec<f32>| {
            let values: Vec<f32> = views.iter().flat_map(map).collect();
            round_upper_limit(&values, REACH)
        };
        let unit = if metres_per_unit.is_some() {
            "m"
        } else {
            "scene units"
        };
        let error = |view: &ViewMaps| {
            view.truth
                .as_ref()
                .map_or_else(Vec::new, |truth| truth.error.clone())
        };
        Self {
            std: scale(
                "std of gray, B-1",
                "sRGB, white = 1",
                top(&|view| view.maps.std.clone()),
            ),
            opacity: scale("unseen: (1-opacity)^2", "share", 1.0),
            total: scale(
                "total sd, with unseen",
                "sRGB, white = 1",
                top(&|view| view.maps.total.clone()),
            ),
            depth: ColorScale {
                palette: Palette::Viridis,
                ..scale(
                    "mean depth",
                    unit,
                    top(&|view| in_metres(&view.maps.depth, metres_per_unit)),
                )
            },
            depth_std: scale(
                "std of depth, B-1",
                unit,
                top(&|view| in_metres(&view.maps.depth_std, metres_per_unit)),
            ),
            error: scale("error of the mean", "sRGB, white = 1", top(&error)),
        }
    }
}

/// Returns lengths in metres where the scene knows them, -1 where unseen.
fn in_metres(lengths: &[f32], metres_per_unit: Option<f64>) -> Vec<f32> {
    let metres = metres_per_unit.unwrap_or(1.0) as f32;
    let convert = |length: &f32| if *length < 0.0 { -1.0 } else { length * metres };
    lengths.iter().map(convert).collect()
}

/// Writes every map of a viewpoint as a picture with its scale, and the raw values as arrays.
pub(crate) fn put_view(
    ctx: &Ctx<'_>,
    view: &ViewMaps,
    scales: &Scales,
    metres_per_unit: Option<f64>,
    outputs: &mut Outputs,
) -> Result<(), StageError> {
    let (maps, name) = (&view.maps, &view.name);
    let mut put = |kind: &str, picture: &Image<Srgb>| -> Result<(), StageError> {
        put_png(ctx, outputs, format!("{MAPS}{name}-{kind}.png"), picture)?;
        Ok(())
    };
    let draw = |values: &[f32], scale: &ColorScale| draw_map(values, maps.width, maps.height, scale);
    put("mean", &mean_picture(maps))?;
    put("std", &draw(&maps.std, &scales.std))?;
    put("opacity", &draw(&maps.opacity_term, &scales.opacity))?;
    put("total", &draw(&maps.total, &scales.total))?;
    put(
        "depth-std",
        &draw(&in_metres(&maps.depth_std, metres_per_unit), &scales.depth_std),
    )?;
    if let Some(truth) = &view.truth {
        put("error", &draw(&truth.error, &scales.error))?;
    }
    let shape = [maps.height, maps.width];
    let plain = [
        ("std", &maps.std),
        ("total", &maps.total),
        ("depth-std", &maps.depth_std),
    ];
    for (kind, values) in plain {
        let array = encode_npy(&shape, values.iter().copied());
        outputs.put_bytes(ctx, format!("{MAPS}{name}-{kind}.npy"), &array)?;
    }
    let array = encode_npy(
        &[maps.height, maps.width, 3],
        maps.rgb_std.as_flattened().iter().copied(),
    );
    outputs.put_bytes(ctx, format!("{MAPS}{name}-rgb-std.npy"), &array)
}

/// Returns a picture of the fly-through: mean colour, spread and mean depth side by side, each as wide as the maps.
pub(crate) fn flythrough_picture(
    maps: &Maps,
    scales: &Scales,
    metres_per_unit: Option<f64>,
    shown: Shown,
) -> Image<Srgb> {
    let draw = |values: &[f32], scale: &ColorScale| draw_map(values, maps.width, maps.height, scale);
    let spread = match shown {
        Shown::Std => draw(&maps.std, &scales.std),
        Shown::Total => draw(&maps.total, &scales.total),
    };
    let depth = draw(&in_metres(&maps.depth, metres_per_unit), &scales.depth);
    side_by_side(&[&draw_titled(&mean_picture(maps), "mean colour"), &spread, &depth])
}

/// Returns the size of [`flythrough_picture`] for maps of a size, pixels; the least, where texts are wider than maps.
pub(crate) fn flythrough_size(width: u32, height: u32) -> (u32, u32) {
    let blank = Image::from_fn(width, height, |_, _| [0; 3]);
    let panel = draw_titled(&blank, "");
    (3 * panel.width, panel.height)
}

/// Returns the mean colour, rounded to 8 bits.
pub(crate) fn mean_picture(maps: &Maps) -> Image<Srgb> {
    let round = |value: f32| (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
    Image {
        width: maps.width,
        height: maps.height,
        pixels: maps.mean.iter().map(|rgb| rgb.map(round)).collect(),
    }
}
