//! `marf export mesh | points | splats | height | orthophoto | depth`: files of a trained field for other programs.

use std::path::PathBuf;

use clap::Args;
use marf_progress::format::{count, number};
use marf_run::export::{SurfaceKind, SurfaceRequest, export_surface};
use marf_run::{Context, Error};
use marf_schema::surface::{ColorBy, SplatPsnr, SplatReport, SpreadOf, SurfaceParams, SurfaceReport};

use crate::cli::options::{ResultArgs, word};
use crate::cli::output::print_json;
use crate::terminal::{print_line, print_lines};

/// Arguments of the exports of a surface.
#[derive(Debug, Clone, Args)]
pub struct SurfaceArgs {
    /// Node with a trained field
    #[arg(value_name = "NODE", default_value = "train")]
    pub node: String,
    /// File or folder to write
    #[arg(long, value_name = "PATH")]
    pub out: PathBuf,
    /// Number of the run [default: the newest one that has the node]
    #[arg(long, value_name = "NUMBER")]
    pub run: Option<u64>,
    /// Distance between samples, metres, or units of a scene without scale [default: two pixels of near ground]
    #[arg(long, value_name = "LENGTH")]
    pub cell: Option<f64>,
    /// Largest distance from a photo, in the unit of `--cell` [default: where a pixel is four cells wide]
    #[arg(long, value_name = "LENGTH")]
    pub reach: Option<f64>,
    /// Number of photos that must show a point [default: 2, for splats 1]
    #[arg(long, value_name = "COUNT")]
    pub least_photos: Option<u32>,
    /// Largest difference between views at a point, in the unit of `--cell` [default: one cell]
    #[arg(long, value_name = "LENGTH")]
    pub most_spread: Option<f64>,
    /// Colour of mesh and points: `photos`, or `uncertainty` (spread of the bootstrap's retrainings, or of the views without a bootstrap)
    #[arg(long, value_name = "WHAT", default_value = "photos", value_parser = word::<ColorBy>)]
    pub color: ColorBy,
    /// Pixel size of a map, metres [default: one cell]
    #[arg(long, value_name = "METRES")]
    pub map_cell: Option<f64>,
    #[command(flatten)]
    results: ResultArgs,
}

/// Arguments of `export splats`.
#[derive(Debug, Clone, Args)]
pub struct SplatsArgs {
    #[command(flatten)]
    pub surface: SurfaceArgs,
    /// Folder for pictures of splats and field next to each other at the held-out photos
    #[arg(long, value_name = "DIR")]
    pub pictures: Option<PathBuf>,
}

impl SurfaceArgs {
    /// Computes an export of this kind, unless the store has it, and writes it. `pictures` is the folder for pictures of splats.
    ///
    /// # Errors
    /// Those of [`export_surface`].
    pub fn export(self, kind: SurfaceKind, pictures: Option<PathBuf>, context: Context) -> Result<(), Error> {
        // Splats are for looking at, not for measuring, so one photo is enough.
        let least_photos = self.least_photos.unwrap_or(match kind {
            SurfaceKind::Splats => 1,
            _ => SurfaceParams::default().least_photos,
        });
        let request = SurfaceRequest {
            kind,
            node: self.node,
            out: self.out,
            run: self.run,
            params: SurfaceParams {
                cell: self.cell,
                reach: self.reach,
                least_photos,
                most_spread: self.most_spread,
                color: self.color,
                map_cell: self.map_cell,
                depth: kind == SurfaceKind::Depth,
                splats: kind == SurfaceKind::Splats,
                ..SurfaceParams::default()
            },
            pictures,
        };
        let result = export_surface(&self.results.context(context), &request)?;
        if self.results.json {
            return print_json(&result);
        }
        print_lines(text(kind, &result.surface));
        if matches!(kind, SurfaceKind::Mesh | SurfaceKind::Points) {
            print_line(&uncertainty_text(&result.surface));
        }
        // Depths are a file a photo.
        if kind == SurfaceKind::Depth {
            print_line(&format!(
                "wrote {} to {}",
                count(result.files.len(), "file"),
                request.out.display()
            ));
            return Ok(());
        }
        for path in result.files {
            print_line(&format!("wrote {}", path.display()));
        }
        Ok(())
    }
}

/// Returns how far the retrainings, or the views, differ where that is known.
fn uncertainty_text(report: &SurfaceReport) -> String {
    let uncertainty = &report.uncertainty;
    let what = match uncertainty.of {
        SpreadOf::Retrainings => format!("{} retrainings", uncertainty.members),
        SpreadOf::Views => "no bootstrap: the views of the field".to_owned(),
    };
    let known = uncertainty.known_share;
    if known == 0.0 {
        return format!("{what} show none of the vertices: the uncertainty is not known");
    }
    let of_known = if known < 1.0 {
        format!(" of the {:.1} % of the vertices where it is known", 100.0 * known)
    } else {
        " of the vertices".to_owned()
    };
    format!(
        "{what} differ by at most {} at half{of_known}, by at most {} at 95 %",
        length_text(uncertainty.median, report),
        length_text(uncertainty.scale_end, report)
    )
}

/// Returns a length with its unit. A scene without scale has units of its own.
fn length_text(length: f64, report: &SurfaceReport) -> String {
    let unit = if report.unit == "metres" {
        "m"
    } else {
        "units of the scene"
    };
    format!("{} {unit}", number(length))
}

fn text(kind: SurfaceKind, report: &SurfaceReport) -> Vec<String> {
    let (photos, cell) = (
        count(report.photos as usize, "photo"),
        length_text(report.cell, report),
    );
    if let (SurfaceKind::Splats, Some(splats)) = (kind, &report.splats) {
        return splats_text(splats, report);
    }
    vec![match (kind, &report.map) {
        (SurfaceKind::Points, _) => format!(
            "{} in cells of {cell}, from {photos}",
            count(report.points as usize, "point")
        ),
        (SurfaceKind::Height | SurfaceKind::Orthophoto, Some(map)) => format!(
            "{} x {} pixels of {} m, {:.0} % with a surface, heights from {:.3} m in steps of {} m",
            map.columns,
            map.rows,
            number(map.pixel_m),
            100.0 * map.covered_share,
            map.lowest_m,
            number(map.interval_m)
        ),
        (SurfaceKind::Depth, _) => format!(
            "depths in {} at the views of {photos}, {}",
            report.unit,
            size_text(report.shrunk)
        ),
        _ => format!(
            "{} and {} vertices, samples {cell} apart, from {photos}",
            count(report.triangles as usize, "triangle"),
            number(report.vertices as f64)
        ),
    }]
}

/// Returns how large pictures of depth are, next to their photos.
fn size_text([least, most]: [u32; 2]) -> String {
    let limit = "for more pixels, set `side_px` of a node `surface` with `depth = true`";
    match (least, most) {
        (1, 1) => "as large as the photos".to_owned(),
        (least, most) if least == most => {
            format!("smaller than the photos: {least} x {least} pixels of a photo are one. {limit}")
        }
        (least, most) => format!(
            "of other sizes than the photos: {least} x {least} to {most} x {most} pixels of a photo are one. {limit}"
        ),
    }
}

/// Describes the splats, and how near they come to the field.
fn splats_text(splats: &SplatReport, report: &SurfaceReport) -> Vec<String> {
    let mut text = vec![format!(
        "{}, standard deviations {} to {}, from {}. Left out: {} floating in front of the surface, the sky, and colours by direction",
        count(splats.splats as usize, "splat"),
        number(splats.finest),
        length_text(splats.coarsest, report),
        count(report.photos as usize, "photo"),
        splats.floating
    )];
    for (of, psnr) in [
        ("trained on", splats.trained_on),
        ("held out", splats.held_out),
        (
            "held out, but for what no photo trained on saw",
            splats.held_out_seen,
        ),
    ] {
        text.push(match psnr {
            Some(SplatPsnr {
                photos,
                mean_db,
                least_db,
                share,
            }) => format!(
                "against the field at {photos} photos {of}: PSNR {mean_db:.2} dB, {least_db:.2} the worst, over the {:.0} % of the pixels where it shows a surface",
                100.0 * share
            ),
            None => format!("against the field at photos {of}: nothing to compare"),
        });
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_uncertainty_that_nothing_shows_is_not_a_number() {
        let of = |known_share: f64| {
            let uncertainty = serde_json::json!({"of": SpreadOf::Retrainings, "members": 5, "median": 0.25, "scale_end": 0.5,
                                                 "known_share": known_share});
            let report = serde_json::json!({
                "unit": "metres", "photos": 3, "shrunk": [1, 1], "cell": 0.1, "band": 0.4, "reach": 9.0, "most_spread": 0.1,
                "vertices": 8, "triangles": 12, "points": 4, "uncertainty": uncertainty, "map": null, "splats": null, "refused": {},
            });
            uncertainty_text(&serde_json::from_value(report).unwrap())
        };
        assert_eq!(
            of(0.0),
            "5 retrainings show none of the vertices: the uncertainty is not known"
        );
        assert_eq!(
            of(0.5),
            "5 retrainings differ by at most 0.25 m at half of the 50.0 % of the vertices where it is known, by at most 0.5 m at 95 %"
        );
        assert!(of(1.0).contains(" at half of the vertices, "), "{}", of(1.0));
    }

    #[test]
    fn depths_that_are_smaller_than_their_photos_say_so() {
        assert_eq!(size_text([1, 1]), "as large as the photos");
        assert!(size_text([2, 2]).starts_with("smaller than the photos: 2 x 2 pixels of a photo are one. "));
        let mixed = size_text([1, 3]);
        assert!(
            mixed.starts_with("of other sizes than the photos: 1 x 1 to 3 x 3 pixels of a photo are one. "),
            "{mixed}"
        );
        assert!(mixed.contains("`side_px`"), "{mixed}");
    }
}
