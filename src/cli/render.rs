//! `marf render`: pictures of a trained field along a path, and a film of them.

use std::path::PathBuf;

use clap::Args;
use marf_progress::format::count;
use marf_run::render::{FILM, RenderRequest, RenderResult, SizeRequest};
use marf_run::{Context, Error};
use marf_schema::render::Layer;
use marf_schema::video::VideoParams;

use super::options::{ResultArgs, word};
use super::output::print_json;
use crate::terminal::print_line;

/// Arguments of `render`.
#[derive(Debug, Clone, Args)]
#[command(after_help = AFTER_HELP)]
pub struct RenderArgs {
    /// Node with a trained field
    #[arg(value_name = "NODE", default_value = "train")]
    pub node: String,
    /// Number of the run [default: the newest one that has the node]
    #[arg(long, value_name = "NUMBER")]
    pub run: Option<u64>,
    /// Camera path: `train` or `heldout` (at the photos), `flythrough` (smoothly through the training photos), `orbit`, or a FILE of bookmarks
    #[arg(long, value_name = "PATH|FILE", default_value = "flythrough")]
    pub path: String,
    /// Pictures of each viewpoint: `rgb`, `depth`, `uncertainty`
    #[arg(long, value_name = "WHAT", value_delimiter = ',', default_value = "rgb", value_parser = word::<Layer>)]
    pub output: Vec<Layer>,
    /// Folder to write
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Number of viewpoints along the path [default: 96, all photos for `train` and `heldout`, one for each bookmark of a FILE]
    #[arg(long, value_name = "COUNT")]
    pub frames: Option<u32>,
    #[command(flatten)]
    pub size: SizeArgs,
    /// Frames per second of the film
    #[arg(long, value_name = "RATE", default_value_t = VideoParams::default().fps)]
    pub fps: u32,
    /// Quantiser of the film, from 12 (best quality, largest file) to 51
    #[arg(long, value_name = "QP", default_value_t = VideoParams::default().quantizer)]
    pub quantizer: u32,
    #[command(flatten)]
    results: ResultArgs,
}

const AFTER_HELP: &str = "\
DIR receives rgb/0001.png, depth/ and uncertainty/ (16-bit PNG, the scale in their text chunks) with colour previews, poses.json, and \
video.mp4 with all outputs side by side. A FILE is a bookmark file of `marf view`, or poses.json of another render: without --frames each \
bookmark gives one picture, with --frames the camera moves smoothly through them. Results are kept in the store: the same command again only \
copies them, and a command that was stopped continues.";

/// Options of the size.
#[derive(Debug, Clone, Default, Args)]
pub struct SizeArgs {
    /// Width of a picture, pixels [default: 640, for a FILE that of the first bookmark]
    #[arg(long, value_name = "PIXELS", conflicts_with = "scale")]
    pub width: Option<u32>,
    /// Height of a picture, pixels, which with --width crops or extends the view [default: by the photos or bookmarks]
    #[arg(long, value_name = "PIXELS", conflicts_with = "scale")]
    pub height: Option<u32>,
    /// Size as a factor of that of the photos, or of the first bookmark, e.g. 0.5
    #[arg(long, value_name = "FACTOR")]
    pub scale: Option<f64>,
}

/// `marf render`: renders the pictures, unless the store has them, and writes them.
pub fn render(args: RenderArgs, context: Context) -> Result<(), Error> {
    let request = RenderRequest {
        node: args.node,
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
        quantizer: args.quantizer,
    };
    let result = marf_run::render::render(&args.results.context(context), &request)?;
    if args.results.json {
        return print_json(&result);
    }
    print_line(&text(&request.outputs, &result));
    let film = if result.has_film {
        format!(", {FILM} among them")
    } else {
        String::new()
    };
    print_line(&format!(
        "wrote {} to {}{film}",
        count(result.files.len(), "file"),
        request.out.display()
    ));
    Ok(())
}

/// Returns the size and the contents of the pictures as text.
fn text(outputs: &[Layer], result: &RenderResult) -> String {
    let words = outputs.iter().map(|layer| match layer {
        Layer::Rgb => "colour",
        Layer::Depth if result.metres_per_unit.is_some() => "depth in metres",
        Layer::Depth => "depth in units of the scene, whose scale is not known",
        Layer::Uncertainty => "uncertainty (standard deviation of gray, white = 1)",
    });
    let words: Vec<&str> = words.collect();
    format!(
        "{} of {} x {} pixels: {}",
        count(result.pictures, "viewpoint"),
        result.width,
        result.height,
        words.join(", ")
    )
}
