//! `marf render`: pictures of a trained field along a path, and a film of them.

use std::path::PathBuf;

use clap::Args;
use marf_run::render::{FILM, RenderRequest, RenderResult, SizeRequest};
use marf_run::{Context, Error};
use marf_schema::render::Layer;
use marf_schema::video::{Codec, VideoParams};
use serde_json::json;

use super::global::Global;
use super::output::print_json;
use crate::terminal::print_line;

/// Arguments of `render`.
#[derive(Debug, Clone, Args)]
#[command(after_help = AFTER_HELP)]
pub struct RenderArgs {
    /// A node with a trained field
    #[arg(value_name = "NODE", default_value = "train")]
    pub node: String,
    /// The field in this file instead, as a run of the store made it (`out/train/weights.safetensors`)
    #[arg(long, value_name = "FILE", conflicts_with = "node")]
    pub field: Option<PathBuf>,
    /// Number of the run [default: the last one that has the node]
    #[arg(long, value_name = "NUMBER")]
    pub run: Option<u64>,
    /// Where the camera goes: `train` or `heldout` (to the photos), `interp` (smoothly through those of the training), `orbit`, or a
    /// FILE of bookmarks
    #[arg(long, value_name = "PATH|FILE", default_value = "interp")]
    pub path: String,
    /// What is made at every viewpoint: `rgb`, `depth`, `uncertainty`
    #[arg(long, value_name = "WHAT", value_delimiter = ',', default_value = "rgb", value_parser = layer)]
    pub output: Vec<Layer>,
    /// Folder to write
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Pictures along the path [default: 96; all photos for `train` and `heldout`; one still a bookmark for a FILE]
    #[arg(long, value_name = "COUNT")]
    pub frames: Option<u32>,
    /// Size of the pictures
    #[command(flatten)]
    pub size: SizeArgs,
    /// Pictures a second in the film
    #[arg(long, value_name = "RATE", default_value_t = VideoParams::default().fps)]
    pub fps: u32,
    /// How the film is encoded: `h264`, or `av1`, whose makers license their patents without fees and which takes longer
    #[arg(long, value_name = "CODEC", default_value = "h264", value_parser = codec)]
    pub codec: Codec,
    /// Quantiser of the film, 12 (finest, largest) to 51
    #[arg(long, value_name = "QP", default_value_t = VideoParams::default().quantizer)]
    pub quantizer: u32,
}

const AFTER_HELP: &str = "\
DIR gets rgb/0001.png, depth/ and uncertainty/ (PNG of 16 bits, the scale in their text) with a preview in colours each, poses.json, and \
video.mp4 with all outputs side by side. A FILE is what `marf view` saves as bookmarks, or the poses.json of another render: \
without --frames it gives one still each, with --frames a smooth path through them. What was rendered is kept: the same call again only \
copies, and a call that was stopped goes on.";

/// Reads an output as pipeline.toml has it.
fn layer(word: &str) -> Result<Layer, String> {
    serde_json::from_value(json!(word)).map_err(|error| error.to_string())
}

/// Reads a codec as pipeline.toml has it.
fn codec(word: &str) -> Result<Codec, String> {
    serde_json::from_value(json!(word)).map_err(|error| error.to_string())
}

/// Options of the size.
#[derive(Debug, Clone, Default, Args)]
pub struct SizeArgs {
    /// Width of a picture, pixels [default: 640; that of the first bookmark for a FILE]
    #[arg(long, value_name = "PIXELS", conflicts_with = "scale")]
    pub width: Option<u32>,
    /// Height of a picture, pixels [default: as the photos or bookmarks ask for]; beside --width more or less is seen above and below
    #[arg(long, value_name = "PIXELS", conflicts_with = "scale")]
    pub height: Option<u32>,
    /// Size as a factor of that of the photos, or of the first bookmark, e.g. 0.5
    #[arg(long, value_name = "FACTOR")]
    pub scale: Option<f64>,
}

/// Renders what is wanted, unless it is rendered already, and writes it.
pub fn render(global: &Global, args: RenderArgs, context: &Context) -> Result<(), Error> {
    let request = RenderRequest {
        node: args.node,
        field: args.field,
        run: args.run,
        path: args.path,
        outputs: args.output,
        out: args.out,
        frames: args.frames,
        size: SizeRequest {
            width: args.size.width,
            height: args.size.height,
            scale: args.size.scale,
        },
        fps: args.fps,
        codec: args.codec,
        quantizer: args.quantizer,
    };
    let result = marf_run::render::render(context, &request)?;
    if global.json {
        return print_json(&json!(result));
    }
    print_line(&text(&request.outputs, &result));
    let film = if result.has_film {
        format!(", {FILM} among them")
    } else {
        String::new()
    };
    print_line(&format!(
        "wrote {} files to {}{film}",
        result.files.len(),
        request.out.display()
    ));
    Ok(())
}

/// Says what was made.
fn text(outputs: &[Layer], result: &RenderResult) -> String {
    let words = outputs.iter().map(|layer| match layer {
        Layer::Rgb => "colour",
        Layer::Depth if result.metres_per_unit.is_some() => "depth in metres",
        Layer::Depth => "depth in units of the scene, whose scale is not known",
        Layer::Uncertainty => "uncertainty (standard deviation of gray, white = 1)",
    });
    let words: Vec<&str> = words.collect();
    format!(
        "{} viewpoints of {} x {} pixels: {}",
        result.pictures,
        result.width,
        result.height,
        words.join(", ")
    )
}
