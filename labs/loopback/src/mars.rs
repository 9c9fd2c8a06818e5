//! The Navcam of Mars 2020 as NASA's Imaging Node serves it.

use crate::Server;

const ROOT: &str = "/img/data";
const BROWSE: &str = "/img/data/mars2020/mars2020_navcam_ops_raw/browse/sol";
const DATA: &str = "/img/data/mars2020/mars2020_navcam_ops_raw/data/sol";
const BELOW: &str = "ids/edr/ncam";

impl Server {
    /// Mounts a picture as browse picture `number` of a sol, and the folder where its label would be. Returns its path.
    pub fn navcam(&self, sol: u32, number: u32, png: impl Into<Vec<u8>>) -> String {
        let name = format!("NLF_{sol:04}_06{sol:04}{number:04}_000EBY_N003{number:04}NCAM00500_00_0LLJ01");
        let path = format!("{BROWSE}/{sol:05}/{BELOW}/{name}.png");
        self.file(&path, png);
        self.folder(&format!("{DATA}/{sol:05}/{BELOW}/"));
        path
    }

    /// Returns the section of pipeline.toml that reads these pictures without pauses.
    pub fn navcam_section(&self, archive: &str, sols: &str) -> String {
        let base = self.url(ROOT);
        format!(
            "[archive.{archive}]\nkind = \"pds\"\nmission = \"perseverance\"\ninstrument = \"navcam\"\nsols = \"{sols}\"\n\
             base = [\"{base}\"]\nnetwork = {{ delay_ms = 0, retry_ms = 1 }}\n"
        )
    }
}
