//! Where the Planetary Data System keeps the products of each camera (reference: PDS imaging node, collections of
//! Mars 2020 and volumes of MSL).

use marf_pds::ProductName;
use marf_stage::ParamError;

use super::params::{Level, PdsParams, PixelSource};
use crate::kinds::mission::{Instrument, Mission};

/// A folder that holds one folder a sol.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Tree {
    /// Its path below the archive's base.
    pub root: String,
    /// Pattern of the names of volumes in the root (`?` is any letter or digit), if the archive has volumes.
    pub volumes: Option<&'static str>,
    /// From a volume to the folder of sols.
    pub below_volume: &'static str,
    /// What a sol's folder begins with, and how many digits follow.
    pub sol: (&'static str, usize),
    /// From a sol's folder to the products.
    pub below_sol: String,
    /// Accepted extensions, in lower case.
    pub takes: &'static [&'static str],
}

/// Where the products of one camera lie, and which are taken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct CameraLayout {
    /// Possible layouts. The first that exists is used. Each is a set of trees whose files belong together.
    pub layouts: Vec<Vec<Tree>>,
    /// Codes of the instrument in names.
    pub codes: &'static [&'static str],
    /// Product types, the preferred first.
    pub types: Vec<String>,
}

impl CameraLayout {
    /// Returns the layout of a camera.
    ///
    /// # Errors
    /// A combination that the archive does not have.
    pub fn new(archive: &PdsParams) -> Result<Self, ParamError> {
        let mut layout = match (archive.mission, archive.instrument) {
            (Mission::Perseverance, Instrument::MastcamZ) => {
                mars2020(archive, "mars2020_mastcamz_ops", "zcam", &["ZL", "ZR"])?
            }
            (Mission::Perseverance, Instrument::Navcam) => {
                mars2020(archive, "mars2020_navcam_ops", "ncam", &["NL", "NR"])?
            }
            (Mission::Ingenuity, Instrument::Helicam) => {
                mars2020(archive, "mars2020_helicam", "heli", &["HN", "HS"])?
            }
            (Mission::Curiosity, Instrument::Mastcam) => mastcam(archive)?,
            (Mission::Curiosity, Instrument::Navcam) => curiosity_navcam(archive)?,
            (mission, instrument) => {
                let message = format!("{mission:?} has no {instrument:?}").to_lowercase();
                let hint =
                    "perseverance has mastcam-z and navcam, ingenuity helicam, curiosity mastcam and navcam";
                return Err(ParamError::new("instrument", format!("{message} ({hint})")));
            }
        };
        if !archive.products.is_empty() {
            layout.types = archive
                .products
                .iter()
                .map(|kind| kind.to_ascii_uppercase())
                .collect();
        }
        Ok(layout)
    }

    /// Returns the rank of a product among the wanted types, 0 the best, or why it is not wanted.
    pub fn rank(&self, name: &ProductName) -> Result<usize, String> {
        if name.thumbnail {
            return Err("thumbnail".to_owned());
        }
        if let Some(reason) = name.no_photo() {
            return Err(reason);
        }
        let kind = name.product_type.as_str();
        let place = self
            .types
            .iter()
            .position(|wanted| wanted == kind || wanted == "*");
        place.ok_or_else(|| {
            if name.is_of_series() {
                format!("{kind} is a frame of a video or a stack: name it in `products` to take it")
            } else {
                format!("product type {kind} is not asked for")
            }
        })
    }
}

fn mars2020(
    archive: &PdsParams,
    bundle: &str,
    camera: &str,
    codes: &'static [&'static str],
) -> Result<CameraLayout, ParamError> {
    let (level, kind) = match archive.level {
        Level::Edr => ("edr", "_raw"),
        Level::Fdr => ("fdr", "_calibrated"),
        Level::Rdr => ("rdr", "_calibrated"),
    };
    let single = bundle == "mars2020_helicam";
    if single && archive.level != Level::Edr {
        let message = "the helicopter's bundle has level `edr` only".to_owned();
        return Err(ParamError::new("level", message));
    }
    let bundle = if single {
        bundle.to_owned()
    } else {
        format!("{bundle}{kind}")
    };
    let tree = |side: &str, takes| Tree {
        root: format!("mars2020/{bundle}/{side}/sol"),
        volumes: None,
        below_volume: "",
        sol: ("", 5),
        below_sol: format!("ids/{level}/{camera}"),
        takes,
    };
    let trees = match archive.pixels {
        PixelSource::Browse => vec![tree("browse", &["png"]), tree("data", &["xml"])],
        PixelSource::Img => vec![tree("data", &["img", "xml"])],
    };
    let types: &[&str] = match (archive.level, archive.pixels) {
        (Level::Edr, PixelSource::Browse) => &["EBY", "EDR", "ECM", "EJP"],
        (Level::Edr, PixelSource::Img) => &["EDR", "EBY", "ECM"],
        (Level::Fdr, _) => &["FDR"],
        (Level::Rdr, _) => &["RAD", "RZD", "IOF"],
    };
    Ok(CameraLayout {
        layouts: vec![trees],
        codes,
        types: types.iter().map(|kind| (*kind).to_owned()).collect(),
    })
}

/// Of raw Mastcam products the decompressed ones are taken, which have the calibrated ones next to them.
fn mastcam(archive: &PdsParams) -> Result<CameraLayout, ParamError> {
    if archive.level == Level::Fdr {
        return Err(ParamError::new(
            "level",
            "Curiosity has no level `fdr`".to_owned(),
        ));
    }
    let tree = Tree {
        root: "msl".to_owned(),
        volumes: Some("MSLMST_????"),
        below_volume: "DATA/RDR/SURFACE",
        sol: ("", 4),
        below_sol: String::new(),
        takes: &["img", "lbl", "xml"],
    };
    Ok(CameraLayout {
        layouts: vec![vec![tree]],
        codes: &["ML", "MR"],
        types: ["DRCL", "DRCX", "DRXX", "DRLX", "DXXX"]
            .map(str::to_owned)
            .to_vec(),
    })
}

fn curiosity_navcam(archive: &PdsParams) -> Result<CameraLayout, ParamError> {
    if archive.level != Level::Edr {
        let message = "of Curiosity's Navcam only level `edr` is known here".to_owned();
        return Err(ParamError::new("level", message));
    }
    let tree = |root: &str, volumes, below_volume| Tree {
        root: root.to_owned(),
        volumes,
        below_volume,
        sol: ("SOL", 5),
        below_sol: String::new(),
        takes: &["img", "lbl", "xml"],
    };
    Ok(CameraLayout {
        layouts: vec![
            vec![tree("msl/msl_navcam_raw/DATA", None, "")],
            vec![tree("msl", Some("MSLNAV_?XXX"), "DATA")],
        ],
        codes: &["NLA", "NLB", "NRA", "NRB"],
        types: vec!["EDR".to_owned()],
    })
}

impl Tree {
    /// Reads the sol off the name of a folder.
    pub fn sol_of(&self, folder: &str) -> Option<u32> {
        let digits = folder.strip_prefix(self.sol.0)?;
        let plain = digits.len() == self.sol.1 && digits.bytes().all(|byte| byte.is_ascii_digit());
        plain.then(|| digits.parse().ok()).flatten()
    }

    /// Whether a folder of the root is a volume.
    pub fn is_volume(&self, folder: &str) -> bool {
        let shape = self.volumes.unwrap_or_default();
        let fits = |(byte, shape): (u8, u8)| byte == shape || (shape == b'?' && byte.is_ascii_alphanumeric());
        folder.len() == shape.len() && folder.bytes().zip(shape.bytes()).all(fits)
    }

    /// Returns the folder of a sol's products in the folder that holds the sols.
    pub fn products(&self, sols: &str, folder: &str) -> String {
        let path = format!("{sols}/{folder}");
        match self.below_sol.as_str() {
            "" => path,
            below => format!("{path}/{below}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn archive(text: &str) -> PdsParams {
        toml::from_str(text).unwrap()
    }

    #[test]
    fn every_camera_of_the_three_missions_has_its_place() {
        for (mission, instrument, root) in [
            (
                "perseverance",
                "mastcam-z",
                "mars2020/mars2020_mastcamz_ops_raw/browse/sol",
            ),
            (
                "perseverance",
                "navcam",
                "mars2020/mars2020_navcam_ops_raw/browse/sol",
            ),
            ("ingenuity", "helicam", "mars2020/mars2020_helicam/browse/sol"),
            ("curiosity", "mastcam", "msl"),
            ("curiosity", "navcam", "msl/msl_navcam_raw/DATA"),
        ] {
            let text = format!("mission = '{mission}'\ninstrument = '{instrument}'\nsols = 1");
            let layout = CameraLayout::new(&archive(&text)).unwrap();
            assert_eq!(layout.layouts[0][0].root, root);
        }
    }

    #[test]
    fn what_the_archive_does_not_have_is_refused_with_what_it_has() {
        let refused = |text: &str| CameraLayout::new(&archive(text)).unwrap_err().to_string();
        let wrong = refused("mission = 'curiosity'\ninstrument = 'helicam'\nsols = 1");
        assert!(
            wrong.contains("curiosity has no helicam") && wrong.contains("mastcam and navcam"),
            "{wrong}"
        );
        assert!(
            refused("mission = 'curiosity'\ninstrument = 'mastcam'\nlevel = 'fdr'\nsols = 1").contains("fdr")
        );
        assert!(
            refused("mission = 'ingenuity'\ninstrument = 'helicam'\nlevel = 'rdr'\nsols = 1").contains("edr")
        );
    }

    #[test]
    fn folders_of_sols_and_volumes_are_told_by_their_names() {
        let msl = &mastcam(&archive(
            "mission = 'curiosity'\ninstrument = 'mastcam'\nsols = 1",
        ))
        .unwrap()
        .layouts[0][0];
        assert!(
            msl.is_volume("MSLMST_0012") && !msl.is_volume("MSLMST_001") && !msl.is_volume("MSLNAV_0012")
        );
        assert_eq!(
            (msl.sol_of("0412"), msl.sol_of("00412"), msl.sol_of("CRUISE")),
            (Some(412), None, None)
        );
        assert_eq!(
            msl.products("msl/MSLMST_0001/DATA/RDR/SURFACE", "0001"),
            "msl/MSLMST_0001/DATA/RDR/SURFACE/0001"
        );
    }
}
