//! The raw-image feeds of Mars 2020 and MSL: pages of records to offers.
//!
//! The record is the label. Pages are asked for by runs of sols and remembered by sol.

use std::collections::{BTreeMap, BTreeSet};

use marf_pds::values;
use marf_stage::{Ctx, ParamError, StageError};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::crawl::{memory_key, recall, remember, urls};
use super::offer::{Offer, Offered, Offers, Survey};
use crate::net::{Answer, Client, Origin, Url, Want};
use crate::params::{FeedArchive, Instrument, Mission};
use crate::sols::Sols;

/// Records asked for at a time.
const PER_PAGE: usize = 100;
/// Sols asked for at a time.
const RUN_SOLS: u32 = 20;
/// Most pages of one question: a hundred thousand pictures in a run of sols.
const MAX_PAGES: usize = 1_000;
const MAX_PAGE_BYTES: u64 = 32 << 20;
const MAX_PICTURE_BYTES: u64 = 64 << 20;

/// One camera of a feed.
pub(crate) struct Feed {
    form: Form,
    /// Names of the camera's eyes in the feed.
    instruments: &'static [&'static str],
    bases: Vec<String>,
    /// Where its pictures may lie.
    allowed: Vec<Origin>,
    relist_sols: u32,
}

/// How a mission's feed asks and answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    /// `images[]`, nested; the categories asked for.
    Mars2020(&'static str),
    /// `items[]`, flat.
    Msl,
}

/// Records of one sol, as remembered.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct Remembered {
    settled: bool,
    records: BTreeMap<String, Value>,
}

impl Feed {
    /// Finds the feed of a camera.
    ///
    /// # Errors
    /// A camera that the mission does not have.
    pub fn new(archive: &FeedArchive, bases: Vec<String>, allowed: Vec<Origin>) -> Result<Self, ParamError> {
        let (form, instruments): (Form, &'static [&'static str]) = match (archive.mission, archive.instrument)
        {
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
                return Err(ParamError::new("archive.instrument", message));
            }
        };
        Ok(Self {
            form,
            instruments,
            bases,
            allowed,
            relist_sols: archive.network.relist_sols,
        })
    }

    fn newest(&self, asking: &Asking<'_>) -> Result<Option<u32>, StageError> {
        let path = match self.form {
            Form::Mars2020(category) => {
                format!("rss/api/?feed=raw_images&category={category}&feedtype=json&ver=1.2&latest=true")
            }
            Form::Msl => "api/v1/raw_image_items/msl/latest/".to_owned(),
        };
        let json = asking.one(&path)?;
        Ok(json
            .get("latest_sol")
            .and_then(text)
            .and_then(|sol| values::sol(&sol)))
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
        asking: &Asking<'_>,
        first: u32,
        last: u32,
    ) -> Result<BTreeMap<u32, Records>, StageError> {
        let (mut sols, mut seen): (BTreeMap<u32, Records>, usize) = (BTreeMap::new(), 0);
        for page in 0..MAX_PAGES {
            let json = asking.one(&self.page_path(first, last, page))?;
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
            asking.ctx.progress.at(
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

    /// The records of a page that are of this mission and camera, and how many there are in all.
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

    fn offer(&self, records: &Records) -> Offer {
        let mut offer = Offer::default();
        for (id, record) in records {
            match self.picture(record) {
                Ok(Picture { url, extension }) => {
                    let offered = |urls, bytes| Offered {
                        urls,
                        cap_bytes: MAX_PICTURE_BYTES,
                        listed: None,
                        bytes,
                    };
                    let label = record.to_string().into_bytes();
                    offer
                        .files
                        .insert(format!("{id}.{extension}"), offered(vec![url], None));
                    offer
                        .files
                        .insert(format!("{id}.json"), offered(Vec::new(), Some(label)));
                }
                Err(reason) => drop(offer.left_out.insert(id.clone(), reason)),
            }
        }
        offer
    }

    fn picture(&self, record: &Value) -> Result<Picture, String> {
        let instrument = field(record, "instrument").unwrap_or_default();
        if !self.instruments.contains(&instrument.as_str()) {
            return Err(format!("of another camera ({})", instrument.escape_default()));
        }
        let is =
            |key: &str, word: &str| field(record, key).is_some_and(|text| text.eq_ignore_ascii_case(word));
        if is("sample_type", "thumbnail") || is("is_thumbnail", "true") {
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
        if !Origin::of(&url).is_some_and(|origin| self.allowed.contains(&origin)) {
            let host = url.host_str().unwrap_or_default();
            return Err(format!(
                "its picture is at `{}`, which `picture_hosts` does not name",
                host.escape_default()
            ));
        }
        Ok(Picture { url, extension })
    }

    fn remembered(&self, sol: u32) -> marf_cache::Digest {
        memory_key(
            "feed",
            &format!("{:?} {} {sol}", self.form, self.instruments.join(" ")),
        )
    }
}

impl Offers for Feed {
    fn survey(&self, ctx: &Ctx<'_>, client: &Client, sols: &Sols) -> Result<Survey, StageError> {
        let asking = Asking {
            ctx,
            client,
            bases: &self.bases,
        };
        let newest = self.newest(&asking)?;
        let wanted = wanted(sols, newest)?;
        let settled = |sol: u32| newest.is_some_and(|newest| newest.saturating_sub(sol) >= self.relist_sols);
        let mut known: BTreeMap<u32, Remembered> = BTreeMap::new();
        let mut asked = BTreeSet::new();
        for sol in wanted {
            match recall::<Remembered>(ctx.scratch, &self.remembered(sol)) {
                Some(remembered) if remembered.settled => drop(known.insert(sol, remembered)),
                _ => drop(asked.insert(sol)),
            }
        }
        for (first, last) in runs(&asked) {
            let mut found = self.records(&asking, first, last)?;
            for sol in (first..=last).filter(|sol| asked.contains(sol)) {
                let remembered = Remembered {
                    settled: settled(sol),
                    records: found.remove(&sol).unwrap_or_default(),
                };
                remember(ctx.scratch, &self.remembered(sol), &remembered);
                known.insert(sol, remembered);
            }
        }
        let offers: BTreeMap<u32, Offer> = known
            .into_iter()
            .map(|(sol, remembered)| (sol, self.offer(&remembered.records)))
            .filter(|(_, offer)| !offer.is_empty())
            .collect();
        let present = offers.keys().copied().chain(newest).collect();
        let offers = match sols {
            Sols::Latest => latest(offers),
            _ => offers,
        };
        Ok(Survey { offers, present })
    }
}

type Records = BTreeMap<String, Value>;

struct Picture {
    url: Url,
    extension: String,
}

/// A way to the pages of a feed.
struct Asking<'a> {
    ctx: &'a Ctx<'a>,
    client: &'a Client,
    bases: &'a [String],
}

impl Asking<'_> {
    fn one(&self, path: &str) -> Result<Value, StageError> {
        let want = Want {
            urls: urls(self.bases, path)?,
            cap_bytes: MAX_PAGE_BYTES,
            known: None,
            part: None,
        };
        let mut got = None;
        self.client.get_all(self.ctx, &[want], &mut |_, answer| {
            got = Some(answer?);
            Ok(())
        })?;
        match got {
            Some(Answer::Whole { bytes, url, .. }) => serde_json::from_slice(&bytes).map_err(|error| {
                StageError::new(format!("`{url}` answered no JSON"))
                    .cause(error.to_string())
                    .hint("a firewall may have answered: open the address in a browser, or set `base`")
            }),
            _ => Err(
                StageError::new(format!("the feed is not at {}", self.bases.join(", ")))
                    .hint("it may have moved: set `base` of the archive"),
            ),
        }
    }
}

/// The latest sol on which this camera took a photo.
fn latest(mut offers: BTreeMap<u32, Offer>) -> BTreeMap<u32, Offer> {
    offers.retain(|_, offer| !offer.files.is_empty());
    offers.pop_last().into_iter().collect()
}

/// The sols to ask for; for the latest a run of them, since the feed's latest sol is that of any camera.
fn wanted(sols: &Sols, newest: Option<u32>) -> Result<BTreeSet<u32>, StageError> {
    let unknown = || {
        StageError::new("the feed does not tell its latest sol")
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

/// Runs of sols that are asked for together; between them at most a few that are not.
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

fn sol_of(record: &Value) -> Option<u32> {
    field(record, "sol").and_then(|sol| values::sol(&sol))
}

/// The record's id, if it can be part of a name: what a server writes never is a path.
fn id_of(record: &Value) -> Option<String> {
    let id = field(record, "imageid")?;
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-';
    (id.len() <= 80 && id.bytes().all(plain)).then_some(id)
}

/// A known value at the top, or under `camera` or `extended`.
fn field(record: &Value, key: &str) -> Option<String> {
    let places = [Some(record), record.get("camera"), record.get("extended")];
    places
        .into_iter()
        .flatten()
        .find_map(|place| place.get(key).and_then(text))
}

fn text(value: &Value) -> Option<String> {
    match value {
        Value::String(text) => values::known(text),
        Value::Number(number) => Some(number.to_string()),
        Value::Bool(truth) => Some(truth.to_string()),
        _ => None,
    }
}

#[cfg(test)]
mod tests;
