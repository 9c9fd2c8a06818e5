//! Which of the products that are found are taken: of each exposure the preferred type, of each product the newest
//! version, each with its label.

use std::collections::BTreeMap;

use marf_pds::{ProductName, join_key};
use marf_stage::StageError;
use serde::{Deserialize, Serialize};

use super::layout::CameraLayout;
use crate::archive::{extension, stem};
use crate::remote::catalog::{RemoteFile, SolFiles};
use crate::remote::crawl::urls;

/// Largest files by extension. Products of these cameras have at most 20 MB.
const MAX_IMG_BYTES: u64 = 64 << 20;
const MAX_PNG_BYTES: u64 = 32 << 20;
const MAX_LABEL_BYTES: u64 = 2 << 20;

/// Where the products of one camera lie.
pub(super) struct Products {
    /// Its folders, and which types are taken.
    pub layout: CameraLayout,
    /// Addresses of the archive, in order of preference.
    pub bases: Vec<String>,
}

/// A file that a listing or a table names.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct FoundFile {
    /// Its folder, below the base.
    pub folder: String,
    /// Its name.
    pub name: String,
    /// When it was last changed.
    pub modified: Option<String>,
}

impl Products {
    /// Selects the wanted files of a sol.
    ///
    /// # Errors
    /// A base that is not an address.
    pub fn taken(&self, sol: u32, found: Vec<FoundFile>) -> Result<SolFiles, StageError> {
        let mut taken = SolFiles::default();
        let mut photos: Vec<(ProductName, usize, FoundFile)> = Vec::new();
        let mut labels: BTreeMap<String, Vec<FoundFile>> = BTreeMap::new();
        for file in found {
            let name = ProductName::read(stem(&file.name));
            let is_label = matches!(extension(&file.name).as_str(), "xml" | "lbl");
            match name.ok_or("its name follows no scheme of the mission".to_owned()) {
                Ok(name) if is_label => labels.entry(join_key(&name.id)).or_default().push(file),
                Ok(name) => match self.rank(&name, sol) {
                    Ok(rank) => photos.push((name, rank, file)),
                    Err(reason) => drop(taken.left_out.insert(file.name, reason)),
                },
                Err(_) if is_label => {}
                Err(reason) => drop(taken.left_out.insert(file.name, reason)),
            }
        }
        let all = self.layout.types.iter().any(|kind| kind == "*");
        for (name, file) in preferred(photos, all, &mut taken.left_out) {
            let label = labels
                .get(&join_key(&name.id))
                .and_then(|labels| labels.iter().max_by_key(|label| &label.name));
            for file in label.into_iter().chain([&file]) {
                taken.files.insert(file.name.clone(), self.remote_file(file)?);
            }
        }
        Ok(taken)
    }

    /// Returns the rank of a product, 0 the best, or why it is not taken.
    fn rank(&self, name: &ProductName, sol: u32) -> Result<usize, String> {
        if !self.layout.codes.contains(&name.instrument.as_str()) {
            return Err(format!("of another camera ({})", name.instrument));
        }
        match name.sol {
            Some(other) if other != sol => Err(format!("its name says sol {other}, its folder sol {sol}")),
            _ => self.layout.rank(name),
        }
    }

    fn remote_file(&self, file: &FoundFile) -> Result<RemoteFile, StageError> {
        Ok(RemoteFile {
            urls: urls(&self.bases, &format!("{}/{}", file.folder, file.name))?,
            cap_bytes: match extension(&file.name).as_str() {
                "img" => MAX_IMG_BYTES,
                "xml" | "lbl" => MAX_LABEL_BYTES,
                _ => MAX_PNG_BYTES,
            },
            listed: file.modified.clone(),
            bytes: None,
        })
    }
}

/// Selects the preferred product of each exposure and the newest version of each product. The others go to
/// `left_out`.
fn preferred(
    photos: Vec<(ProductName, usize, FoundFile)>,
    all: bool,
    left_out: &mut BTreeMap<String, String>,
) -> Vec<(ProductName, FoundFile)> {
    let mut groups: BTreeMap<String, Vec<(ProductName, usize, FoundFile)>> = BTreeMap::new();
    for photo in photos {
        let key = if all {
            join_key(&photo.0.id)
        } else {
            photo.0.exposure_key()
        };
        groups.entry(key).or_default().push(photo);
    }
    let mut best = Vec::new();
    for (_, mut group) in groups {
        group.sort_by(|a, b| (a.1, &b.0.version, &a.2.name).cmp(&(b.1, &a.0.version, &b.2.name)));
        let mut group = group.into_iter();
        let Some((name, _, file)) = group.next() else {
            continue;
        };
        for (other, _, rest) in group {
            let reason = if join_key(&other.id) == join_key(&name.id) {
                format!("version {} is superseded by {}", other.version, name.version)
            } else {
                format!("of this exposure {} is taken", name.id)
            };
            left_out.insert(rest.name, reason);
        }
        best.push((name, file));
    }
    best
}
