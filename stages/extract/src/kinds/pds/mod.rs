//! The imaging node of the Planetary Data System: one camera of one mission.
//!
//! ```text
//! params.rs     the keys of the table
//! layout.rs     where the archive keeps the products of each camera
//! listing.rs    products found by folder pages
//! products.rs   choice among the found products
//! check.rs      one page of each kind
//! ```

mod check;
mod layout;
mod listing;
mod params;
mod products;

use marf_stage::{ParamError, Sols, StageError};

use self::layout::CameraLayout;
use self::params::PdsParams;
use self::products::Products;
use crate::archive::ArchiveFiles;
use crate::archive::access::{Remote, RemoteContext};
use crate::archive::kind::ArchiveKind;
use crate::check::Checkup;
use crate::remote::catalog::{Catalog, CatalogSource, ListedSol, Question, SolFiles};
use crate::remote::crawl::Crawl;
use crate::remote::network::bases;
use crate::remote::pages::Pages;
use crate::remote::{RemoteArchive, Request};

/// Mirrors of the imaging node, in order of preference: `mars2020/BUNDLE/…` and `msl/…` lie below them. The second is
/// the older address of the same trees, and may redirect to the first.
const MIRRORS: [&str; 2] = [
    "https://planetarydata.jpl.nasa.gov/img/data",
    "https://pds-imaging.jpl.nasa.gov/data",
];

/// One camera of the archive.
pub(crate) struct Pds {
    products: Products,
    /// Sols younger than the newest by less may be listed again.
    relist_sols: u32,
}

impl ArchiveKind for Pds {
    type Params = PdsParams;
    type Location = Remote;
    const KIND: &'static str = "pds";
    const ABOUT: &'static str = "one camera of one mission in the Planetary Data System";

    fn open(params: PdsParams, context: RemoteContext) -> Result<Box<dyn ArchiveFiles>, ParamError> {
        let layout = CameraLayout::new(&params)?;
        let (mission, instrument, level, pixels) =
            (params.mission, params.instrument, params.level, params.pixels);
        let asked = format!("pds {mission:?} {instrument:?} {level:?} {pixels:?}").to_lowercase();
        let bases = bases(&params.base, &MIRRORS);
        let request = Request {
            asked,
            sols: params.sols,
            network: &params.network,
            allowed: &bases,
        };
        let source = Self {
            products: Products {
                layout,
                bases: bases.clone(),
            },
            relist_sols: params.network.relist_sols,
        };
        Ok(Box::new(RemoteArchive::new(context, request, Box::new(source))?))
    }
}

impl CatalogSource for Pds {
    fn selection(&self) -> String {
        self.products.layout.types.join(" ")
    }

    fn name(&self) -> String {
        self.products.bases.join(" ")
    }

    fn catalog(&self, question: Question<'_>, pages: &mut Pages) -> Result<Catalog, StageError> {
        let mut crawl = Crawl {
            ctx: question.ctx,
            client: question.client,
            bases: &self.products.bases,
            pages,
        };
        listing::by_listing(&self.products, &mut crawl, question, self.relist_sols)
    }

    fn files(&self, pages: &Pages, sol: u32, listing: &[String]) -> Result<Option<SolFiles>, StageError> {
        let mut found = Vec::new();
        for path in listing {
            let Some(files) = listing::files_of(&self.products, pages, path) else {
                return Ok(None);
            };
            found.extend(files);
        }
        self.products.taken(sol, found).map(Some)
    }

    fn check(&self, sols: &Sols, checkup: &mut Checkup<'_>) -> Result<Option<ListedSol>, StageError> {
        check::by_listing(&self.products, checkup, sols)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::net::Origin;

    #[test]
    fn every_mirror_is_asked_over_https() {
        for base in MIRRORS {
            assert!(
                Origin::parse(base).unwrap().is_secure() && !base.ends_with('/'),
                "{base}"
            );
        }
    }
}
