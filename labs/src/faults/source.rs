//! What the pipelines of the faults read: photos in a folder, with training and retrainings behind them, and photos that a
//! server sends slowly.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::Duration;

use marf_cache::Digest;
use marf_loopback::{Reply, Server};
use marf_run::files;
use marf_scene::{Image, Srgb, encode_png};

use crate::output::Result;
use crate::synthetic::{FIVE_NODES, Shade, picture, random};

/// The rest of the filters, cameras, a training and two retrainings, in a second.
const BEHIND: &str = r#"[node.grayscale]
input = "blur"
[node.histogram]
input = "grayscale"
[node.calibrate]
input = "extract"
cameras = "extract"
method = "import"
[node.train]
input = "calibrate"
steps = 20
scale = 8
field = { batch_samples = 2_048, occupancy_resolution = 32, log2_table = 10 }
[node.bootstrap]
input = "calibrate"
steps = 10
scale = 8
field = { batch_samples = 2_048, occupancy_resolution = 32, log2_table = 10 }
b = 2
"#;
/// Photos in the folder: a ring of cameras around nothing in particular.
const RING: u32 = 12;
/// Size of a photo, pixels.
const SIZE: (u32, u32) = (160, 120);
/// Sols on the server.
const SOLS: u32 = 4;
/// Photos of a sol on the server.
const A_SOL: u32 = 4;
/// Side of the one large photo, pixels. As PNG it has 3 MB, and each MiB has a checksum of its own.
const LARGE: u32 = 1_024;
/// Pace of the server: a sol takes some hundredths of a second.
const PACE: Reply = Reply::Drip {
    bytes: 32 << 10,
    every: Duration::from_millis(2),
};

/// Where photos come from.
pub struct Source {
    /// The text of the pipeline.
    pub pipeline: String,
    /// Digests of all that may be pinned.
    pub products: BTreeSet<Digest>,
    /// Lives as long as this.
    _server: Option<Server>,
}

impl Source {
    /// Writes photos into a folder below this one.
    ///
    /// # Errors
    /// A folder that cannot be written.
    pub fn folder(dir: &Path) -> Result<Self> {
        let photos = dir.join("photos");
        files::write(&photos.join("transforms.json"), ring().to_string().as_bytes())?;
        for at in 0..RING {
            let bytes = picture(u64::from(at), SIZE.0, SIZE.1, Shade::Full)?;
            files::write(&photos.join(photo_name(at)), &bytes)?;
        }
        let path = toml::Value::String(photos.to_string_lossy().into_owned());
        let archive = format!("name = \"faults\"\n[archive.photos]\nkind = \"folder\"\npath = {path}\n");
        Ok(Self {
            pipeline: [&archive, FIVE_NODES, BEHIND].concat(),
            products: BTreeSet::new(),
            _server: None,
        })
    }

    /// Starts a server with photos.
    ///
    /// # Errors
    /// A system without a free port.
    pub fn server() -> Result<Self> {
        let server = Server::start()?;
        let mut products = BTreeSet::new();
        for (sol, number) in (1..=SOLS).flat_map(|sol| (0..A_SOL).map(move |number| (sol, number))) {
            let (width, height) = match (sol, number) {
                (1, 0) => (LARGE, LARGE),
                _ => SIZE,
            };
            let png = noise(sol << 8 | number, width, height)?;
            products.insert(Digest::from_content(&png));
            let path = server.navcam(sol, number, png);
            server.script(&path, vec![PACE.always()]);
        }
        let archive = server.navcam_section("photos", &format!("1..={SOLS}"));
        Ok(Self {
            pipeline: ["name = \"fetches\"\n", &archive, FIVE_NODES].concat(),
            products,
            _server: Some(server),
        })
    }
}

fn photo_name(at: u32) -> String {
    format!("images/{at:02}.jpg")
}

/// Returns a picture of random pixels as PNG, which hardly shrinks.
fn noise(seed: u32, width: u32, height: u32) -> Result<Vec<u8>> {
    let image: Image<Srgb> = Image::from_fn(width, height, |x, y| {
        let bits = random(u64::from(seed), u64::from(y) << 32 | u64::from(x));
        [bits as u8, (bits >> 8) as u8, (bits >> 16) as u8]
    });
    Ok(encode_png(&image)?)
}

/// Returns the cameras of the photos, in nerfstudio's form: on a circle, looking at its middle.
fn ring() -> serde_json::Value {
    let frame = |at: u32| {
        let angle = f64::from(at) / f64::from(RING) * std::f64::consts::TAU;
        let (sin, cos) = angle.sin_cos();
        // Columns: right, up, back, position.
        serde_json::json!({
            "file_path": photo_name(at),
            "transform_matrix": [
                [-sin, 0.0, cos, 3.0 * cos], [cos, 0.0, sin, 3.0 * sin], [0.0, 1.0, 0.0, 0.5], [0.0, 0.0, 0.0, 1.0],
            ],
        })
    };
    let (width, height) = SIZE;
    serde_json::json!({
        "camera_model": "OPENCV", "w": width, "h": height, "fl_x": 150.0, "fl_y": 150.0,
        "cx": f64::from(width) / 2.0, "cy": f64::from(height) / 2.0,
        "frames": (0..RING).map(frame).collect::<Vec<_>>(),
    })
}
