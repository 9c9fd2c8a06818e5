//! The raw-image feeds of Mars 2020 and MSL: one camera of one mission.
//!
//! The record of a photo is its label. Records are requested by runs of sols and kept by sol. The first request, for
//! the latest sol, returns the total number of photos. While that number is unchanged, nothing else is requested. A
//! revised record is noticed with the next photo that the feed adds.

mod check;
mod question;
mod records;

use std::collections::{BTreeMap, BTreeSet};

use marf_pds::feed::{field, is_thumbnail, text};
use marf_stage::{ParamError, StageError};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::Value;

use self::question::{FeedPages, Newest};
use self::records::{id_of, sol_of};
use super::mission::{Instrument, Mission};
use crate::archive::ArchiveFiles;
use crate::archive::access::{Remote, RemoteContext};
use crate::archive::kind::ArchiveKind;
use crate::check::Checkup;
use crate::net::{Origin, Url};
use crate::remote::catalog::{Catalog, CatalogSource, ListedSol, Question, RemoteFile, SolFiles, SolListing};
use crate::remote::network::{Network, bases, origins};
use crate::remote::pages::{PageState, Pages};
use crate::remote::{RemoteArchive, Request};
use marf_stage::Sols;

/// The raw-image feeds of both missions: lists of photos, hours after their downlink.
const FEEDS: &str = "https://mars.nasa.gov";
/// Another host of photos that the feeds name.
const PICTURES: &str = "https://mars.jpl.nasa.gov";

/// Records asked for at a time.
const PER_PAGE: usize = 100;
/// Sols asked for at a time.
const RUN_SOLS: u32 = 20;
/// Most pages of one question: a hundred thousand pictures in a run of sols.
const MAX_PAGES: usize = 1_000;
const MAX_PICTURE_BYTES: u64 = 64 << 20;

/// The keys of `kind = "feed"`.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct FeedParams {
    /// The mission.
    mission: Mission,
    /// The camera.
    instrument: Instrument,
    /// Sols: `1..=5`, `3`, `1,4,7..=9` or `latest`.
    sols: Sols,
    /// Addresses of the feed, tried in this order.
    #[serde(default)]
    base: Vec<String>,
    /// Hosts that pictures may come from, in addition to those of `base`.
    #[serde(default)]
    picture_hosts: Vec<String>,
    /// How the network is used.
    #[serde(default)]
    network: Network,
}

/// One camera of a feed.
pub(crate) struct Feed {
    form: Form,
    /// Names in the feed of the left and the right camera.
    instruments: &'static [&'static str],
    bases: Vec<String>,
    /// Origins that its pictures may come from.
    allowed: Vec<Origin>,
    relist_sols: u32,
}

/// The form of a mission's questions and answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    /// `images[]`, nested, with the requested categories.
    Mars2020(&'static str),
    /// `items[]`, flat.
    Msl,
}

impl ArchiveKind for Feed {
    type Params = FeedParams;
    type Location = Remote;
    const KIND: &'static str = "feed";
    const ABOUT: &'static str = "one camera of one mission in NASA's raw-image feeds";

    fn open(params: FeedParams, context: RemoteContext) -> Result<Box<dyn ArchiveFiles>, ParamError> {
        let bases = bases(&params.base, &[FEEDS]);
        let mut allowed = bases.clone();
        allowed.extend(params.picture_hosts.iter().cloned());
        if params.base.is_empty() {
            allowed.extend([FEEDS, PICTURES].map(str::to_owned));
        }
        let feed = Self::new(&params, bases, origins(&allowed)?)?;
        let request = Request {
            asked: format!("feed {:?} {:?}", params.mission, params.instrument).to_lowercase(),
            sols: params.sols,
            network: &params.network,
            allowed: &allowed,
        };
        Ok(Box::new(RemoteArchive::new(context, request, Box::new(feed))?))
    }
}

impl Feed {
    /// Returns the feed of a camera.
    ///
    /// # Errors
    /// A camera that the mission does not have.
    fn new(params: &FeedParams, bases: Vec<String>, allowed: Vec<Origin>) -> Result<Self, ParamError> {
        let (form, instruments): (Form, &'static [&'static str]) = match (params.mission, params.instrument) {
            (Mission::Perseverance, Instrument::MastcamZ) => {
                (Form::Mars2020("mars2020"), &["MCZ_LEFT", "MCZ_RIGHT"])
            }
            (Mission::Perseverance, Instrument::Navcam) => {
                (Form::Mars2020("mars2020"), &["NAVCAM_LEFT", "NAVCAM_RIGHT"])
            }
            (Mission::Ingenuity, Instrument::Helicam) => {
                (Form::Mars2020("mars2020,ingenuity"), &["HELI_NAV", "HELI_RTE"])
            }
            (Mission::Curiosity, Instrument::Mastcam) => (Form::Msl, &["MAST_LEFT", "MAST_RIGHT"]),
            (Mission::Curiosity, Instrument::Navcam) => (
                Form::Msl,
                &["NAV_LEFT_A", "NAV_RIGHT_A", "NAV_LEFT_B", "NAV_RIGHT_B"],
            ),
            (mission, instrument) => {
                let message = format!("{mission:?} has no {instrument:?}").to_lowercase();
                return Err(ParamError::new("instrument", message));
            }
        };
        Ok(Self {
            form,
            instruments,
            bases,
            allowed,
            relist_sols: params.network.relist_sols,
        })
    }

    /// Asks for the latest sol: the one question of a run with nothing new.
    fn newest(&self, pages: &FeedPages<'_>) -> Result<Newest, StageError> {
        Ok(Newest::from_answer(&pages.one(&self.latest_path())?))
    }

    fn latest_path(&self) -> String {
        match self.form {
            Form::Mars2020(category) => {
                format!("rss/api/?feed=raw_images&category={category}&feedtype=json&ver=1.2&latest=true")
            }
            Form::Msl => "api/v1/raw_image_items/msl/latest/".to_owned(),
        }
    }

    fn page_path(&self, first: u32, last: u32, page: usize) -> String {
        let search = self.instruments.join("%7C");
        match self.form {
            Form::Mars2020(category) => format!(
                "rss/api/?feed=raw_images&category={category}&feedtype=json&ver=1.2&num={PER_PAGE}&page={page}\
                 &order=sol%20desc&search={search}&condition_2={first}:sol:gte&condition_3={last}:sol:lte"
            ),
            Form::Msl => format!(
                "api/v1/raw_image_items/?order=sol%20desc&per_page={PER_PAGE}&page={page}&search={search}\
                 &condition_1=msl:mission&condition_2={first}:sol:gte&condition_3={last}:sol:lte"
            ),
        }
    }

    /// Asks for all records of a run of sols, page by page.
    fn records(
        &self,
        pages: &FeedPages<'_>,
        first: u32,
        last: u32,
    ) -> Result<BTreeMap<u32, Records>, StageError> {
        let (mut sols, mut seen): (BTreeMap<u32, Records>, usize) = (BTreeMap::new(), 0);
        for page in 0..MAX_PAGES {
            let json = pages.one(&self.page_path(first, last, page))?;
            let (records, total) = self.read_page(&json, first, last)?;
            let before: usize = sols.values().map(BTreeMap::len).sum();
            seen += records.len();
            let empty = records.is_empty();
            for record in records {
                let (Some(sol), Some(id)) = (sol_of(record), id_of(record)) else {
                    continue;
                };
                if (first..=last).contains(&sol) {
                    sols.entry(sol).or_default().insert(id, record.clone());
                }
            }
            let after: usize = sols.values().map(BTreeMap::len).sum();
            pages.ctx.progress.at(
                u64::from(first),
                u64::from(last.max(1)),
                "records asked for, by sol",
            );
            // Some answers ignore the page asked for: a page that brings nothing new is the last.
            if empty || total.is_some_and(|total| seen >= total) || (page > 0 && after == before) {
                return Ok(sols);
            }
        }
        Err(StageError::new(format!(
            "the feed of sols {first} to {last} does not end after {MAX_PAGES} pages"
        ))
        .hint("ask for fewer sols"))
    }

    /// Returns the records of a page, and how many there are on all pages.
    fn read_page<'a>(
        &self,
        json: &'a Value,
        first: u32,
        last: u32,
    ) -> Result<(Vec<&'a Value>, Option<usize>), StageError> {
        let (list, total) = match self.form {
            Form::Mars2020(_) => ("images", "total_results"),
            Form::Msl => ("items", "total"),
        };
        let records = json.get(list).and_then(Value::as_array).ok_or_else(|| {
            StageError::new(format!(
                "the feed's answer for sols {first} to {last} has no `{list}`"
            ))
            .hint("the feed may have changed, or a firewall answered: open it in a browser, or set `base`")
        })?;
        let total = json
            .get(total)
            .and_then(text)
            .and_then(|total| total.parse().ok());
        Ok((records.iter().collect(), total))
    }

    /// Returns the files of the records of one sol: of each photo the picture and the record.
    fn sol_files(&self, records: &Records) -> SolFiles {
        let mut files = SolFiles::default();
        for (id, record) in records {
            match self.picture(record) {
                Ok(Picture { url, extension }) => {
                    let file = |urls, bytes| RemoteFile {
                        urls,
                        cap_bytes: MAX_PICTURE_BYTES,
                        listed: None,
                        bytes,
                    };
                    let label = record.to_string().into_bytes();
                    files
                        .files
                        .insert(format!("{id}.{extension}"), file(vec![url], None));
                    files
                        .files
                        .insert(format!("{id}.json"), file(Vec::new(), Some(label)));
                }
                Err(reason) => drop(files.left_out.insert(id.clone(), reason)),
            }
        }
        files
    }

    /// Returns the picture that a record names, or why it is not taken.
    fn picture(&self, record: &Value) -> Result<Picture, String> {
        let instrument = field(record, "instrument").unwrap_or_default();
        if !self.instruments.contains(&instrument.as_str()) {
            return Err(format!("of another camera ({})", instrument.escape_default()));
        }
        if is_thumbnail(record) {
            return Err("thumbnail".to_owned());
        }
        if self.form == Form::Msl
            && field(record, "mission").is_some_and(|mission| !mission.eq_ignore_ascii_case("msl"))
        {
            return Err("of another mission".to_owned());
        }
        let url = match self.form {
            Form::Mars2020(_) => record
                .get("image_files")
                .and_then(|files| files.get("full_res"))
                .and_then(text),
            Form::Msl => field(record, "https_url").or_else(|| field(record, "url")),
        };
        let url = url
            .and_then(|url| Url::parse(&url).ok())
            .ok_or("its record names no picture")?;
        let extension = url
            .path()
            .rsplit('.')
            .next()
            .unwrap_or_default()
            .to_ascii_lowercase();
        if !["png", "jpg", "jpeg"].contains(&extension.as_str()) {
            return Err("its record names no PNG or JPEG".to_owned());
        }
        if !Origin::from_url(&url).is_some_and(|origin| self.allowed.contains(&origin)) {
            let host = url.host_str().unwrap_or_default();
            return Err(format!(
                "its picture is at `{}`, which `picture_hosts` does not name",
                host.escape_default()
            ));
        }
        Ok(Picture { url, extension })
    }

    /// Returns the name of the page that holds the records of a sol.
    fn page(&self, sol: u32) -> String {
        format!("{:?} {} {sol}", self.form, self.instruments.join(" "))
    }

    /// Returns the latest sol with a photo of this camera.
    fn latest(&self, pages: &Pages, sols: BTreeMap<u32, SolListing>) -> BTreeMap<u32, SolListing> {
        let taken = |(sol, listing): &(u32, SolListing)| match listing {
            SolListing::Pinned => true,
            SolListing::Pages(_) => {
                let records: Option<Records> = pages.content(&self.page(*sol));
                records.is_some_and(|records| !self.sol_files(&records).files.is_empty())
            }
        };
        sols.into_iter().rev().find(taken).into_iter().collect()
    }
}

impl CatalogSource for Feed {
    fn selection(&self) -> String {
        let hosts: Vec<String> = self.allowed.iter().map(Origin::authority).collect();
        format!("{} from {}", self.instruments.join(" "), hosts.join(" "))
    }

    fn name(&self) -> String {
        self.bases.join(" ")
    }

    fn catalog(&self, question: Question<'_>, pages: &mut Pages) -> Result<Catalog, StageError> {
        let feed = FeedPages {
            ctx: question.ctx,
            client: question.client,
            bases: &self.bases,
        };
        let Newest { sol: newest, version } = self.newest(&feed)?;
        let settled = |sol: u32| newest.is_some_and(|newest| newest.saturating_sub(sol) >= self.relist_sols);
        let (mut sols, mut asked) = (BTreeMap::new(), BTreeSet::new());
        for sol in wanted(question.sols, newest)? {
            if settled(sol) && (question.is_pinned)(sol) {
                sols.insert(sol, SolListing::Pinned);
                continue;
            }
            let page = self.page(sol);
            let holds = |page: &PageState| {
                (settled(sol) && page.settled) || (version.is_some() && page.version == version)
            };
            if !pages.state(&page).is_some_and(holds) {
                asked.insert(sol);
            }
            sols.insert(sol, SolListing::Pages(vec![page]));
        }
        for (first, last) in runs(&asked) {
            let mut found = self.records(&feed, first, last)?;
            for sol in (first..=last).filter(|sol| asked.contains(sol)) {
                let state = PageState {
                    settled: settled(sol),
                    version: version.clone(),
                    ..PageState::default()
                };
                pages.put(
                    &self.page(sol),
                    state,
                    Some(&found.remove(&sol).unwrap_or_default()),
                );
            }
        }
        Ok(Catalog {
            sols: match question.sols {
                Sols::Latest => self.latest(pages, sols),
                _ => sols,
            },
            present: newest.into_iter().collect(),
        })
    }

    fn files(&self, pages: &Pages, _sol: u32, listing: &[String]) -> Result<Option<SolFiles>, StageError> {
        let mut records = Records::new();
        for page in listing {
            let Some(of_page) = pages.content::<Records>(page) else {
                return Ok(None);
            };
            records.extend(of_page);
        }
        Ok(Some(self.sol_files(&records)))
    }

    fn check(&self, sols: &Sols, checkup: &mut Checkup<'_>) -> Result<Option<ListedSol>, StageError> {
        self.one_page_of_each(sols, checkup)
    }
}

type Records = BTreeMap<String, Value>;

struct Picture {
    url: Url,
    extension: String,
}

/// Returns the sols to request. `latest` becomes a run of sols, since the feed's latest sol is that of any camera.
fn wanted(sols: &Sols, newest: Option<u32>) -> Result<BTreeSet<u32>, StageError> {
    let unknown = || {
        StageError::new("the feed does not report its latest sol")
            .hint("write the sols as a range, e.g. \"1..=5\"")
    };
    match sols {
        Sols::Latest => {
            let newest = newest.ok_or_else(unknown)?;
            Ok((newest.saturating_sub(RUN_SOLS - 1)..=newest).collect())
        }
        Sols::All => Ok((0..=newest.ok_or_else(unknown)?).collect()),
        Sols::Ranges(ranges) => {
            let newest = newest.unwrap_or(99_999);
            let within = |(first, last): &(u32, u32)| *first..=(*last).min(newest);
            Ok(ranges.iter().flat_map(within).collect())
        }
    }
}

/// Returns first and last sol of each run that is requested together. Sols in between may not be wanted.
fn runs(sols: &BTreeSet<u32>) -> Vec<(u32, u32)> {
    let mut runs: Vec<(u32, u32)> = Vec::new();
    for &sol in sols {
        match runs.last_mut() {
            Some((first, last)) if sol - *first < RUN_SOLS => *last = sol,
            _ => runs.push((sol, sol)),
        }
    }
    runs
}

#[cfg(test)]
mod tests;
