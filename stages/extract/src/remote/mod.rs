//! Archives over the network: what is offered, what is pinned, what is fetched.
//!
//! ```text
//! online:          survey (pages, remembered) ─ offers ─┐
//! locked, offline: marf.lock ───────────────────────────┴─ shards ─ fetch what the store lacks ─ pins ─ marf.lock
//! ```
//! A shard's fingerprint holds names, never addresses: the same products from another mirror are the same sol.

mod crawl;
mod feed;
mod fetch;
mod lock;
mod offer;
mod pds;
mod tables;
mod trees;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use marf_cache::{ContentHash, Digest, digest_of};
use marf_stage::{Ctx, Listing, ParamError, Shard, StageError};
use parking_lot::{Mutex, MutexGuard};

use self::lock::{Pins, SolPins};
use self::offer::{Offer, Offers};
use crate::archive::{ArchiveFile, ArchiveFiles};
use crate::net::hosts::{FEED_HOSTS, FEEDS, Host, PDS_MIRRORS};
use crate::net::{Client, Conduct, Origin, Url};
use crate::params::{Access, FeedArchive, Network, PdsArchive, Site};
use crate::sols::Sols;

/// An archive that lies on a server.
pub(crate) struct Remote {
    site: Site,
    /// What the pipeline asks for beside the sols, in words.
    asked: String,
    sols: Sols,
    conduct: Conduct,
    offers: Box<dyn Offers>,
    client: OnceLock<Client>,
    state: Mutex<State>,
}

/// What was last listed, and what is here.
#[derive(Default)]
struct State {
    offers: Option<Arc<BTreeMap<u32, Offer>>>,
    pins: Option<Pins>,
}

/// What of a file decides whether its sol is brought again.
#[derive(ContentHash)]
struct Seen {
    name: String,
    /// Digest of bytes that come with the listing.
    bytes: Option<Digest>,
    /// Other bytes that were given under this name.
    others: Vec<Digest>,
    /// The listing says that it changed since it was fetched.
    changed: Option<String>,
}

/// Opens a camera of the Planetary Data System; nothing is asked yet.
///
/// # Errors
/// A camera the archive does not have, an address that is none.
pub(crate) fn pds(archive: PdsArchive) -> Result<Remote, ParamError> {
    let holding = trees::Holding::of(&archive)?;
    let (level, pixels) = (archive.level, archive.pixels);
    let asked = format!(
        "pds {:?} {:?} {level:?} {pixels:?}",
        archive.mission, archive.instrument
    )
    .to_lowercase();
    let bases = bases(&archive.base, &PDS_MIRRORS);
    let offers = pds::Pds {
        holding,
        discover: archive.discover,
        bases: bases.clone(),
        relist_sols: archive.network.relist_sols,
    };
    offers.check()?;
    Remote::new(
        archive.site,
        asked,
        &archive.sols,
        &archive.network,
        &bases,
        Box::new(offers),
    )
}

/// Opens a camera of a raw-image feed; nothing is asked yet.
///
/// # Errors
/// A camera the mission does not have, an address that is none.
pub(crate) fn feed(archive: FeedArchive) -> Result<Remote, ParamError> {
    let bases = bases(&archive.base, &[FEEDS]);
    let mut allowed = bases.clone();
    allowed.extend(archive.picture_hosts.iter().cloned());
    if archive.base.is_empty() {
        allowed.extend(FEED_HOSTS.map(|host| host.base.to_owned()));
    }
    let offers = feed::Feed::new(&archive, bases, origins(&allowed)?)?;
    let asked = format!("feed {:?} {:?}", archive.mission, archive.instrument).to_lowercase();
    Remote::new(
        archive.site,
        asked,
        &archive.sols,
        &archive.network,
        &allowed,
        Box::new(offers),
    )
}

fn bases(given: &[String], usual: &[Host]) -> Vec<String> {
    if given.is_empty() {
        usual.iter().map(|host| host.base.to_owned()).collect()
    } else {
        given.to_vec()
    }
}

impl Remote {
    fn new(
        site: Site,
        asked: String,
        sols: &str,
        network: &Network,
        allowed: &[String],
        offers: Box<dyn Offers>,
    ) -> Result<Self, ParamError> {
        let sols = Sols::parse(sols).map_err(|message| ParamError::new("archive.sols", message))?;
        Ok(Self {
            site,
            asked,
            sols,
            conduct: conduct(network, allowed)?,
            offers,
            client: OnceLock::new(),
            state: Mutex::default(),
        })
    }

    fn client(&self) -> Result<&Client, StageError> {
        if let Some(client) = self.client.get() {
            return Ok(client);
        }
        let client = Client::new(self.conduct.clone())?;
        Ok(self.client.get_or_init(|| client))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock()
    }

    /// What the archive offers of the sols asked for: now, or as it is locked.
    fn survey(&self, ctx: &Ctx<'_>) -> Result<Arc<BTreeMap<u32, Offer>>, StageError> {
        let pins = self.pins()?;
        let offers = match self.site.access {
            Access::Online => {
                let survey = self.offers.survey(ctx, self.client()?, &self.sols)?;
                if survey.offers.is_empty() {
                    return Err(self.nothing(&survey.present, "the archive has"));
                }
                let none = SolPins::default();
                let with_history = |(sol, offer): (u32, Offer)| {
                    let offer = offer.with_history(pins.sols.get(&sol).unwrap_or(&none));
                    (sol, offer)
                };
                survey.offers.into_iter().map(with_history).collect()
            }
            Access::Locked => self.with_records(ctx, self.locked(&pins)?, &pins)?,
            Access::Offline => self.locked(&pins)?,
        };
        let offers = Arc::new(offers);
        let mut state = self.state();
        state.pins = Some(pins);
        state.offers = Some(Arc::clone(&offers));
        Ok(offers)
    }

    /// What the lock says of what is asked for now; what it says of another camera or level is begun anew.
    fn pins(&self) -> Result<Pins, StageError> {
        let pins = lock::read(&self.site.lock, &self.site.name)?;
        if pins.asked == self.asked {
            return Ok(pins);
        }
        if self.site.access == Access::Online || pins.sols.is_empty() {
            return Ok(Pins {
                asked: self.asked.clone(),
                ..Pins::default()
            });
        }
        let message = format!(
            "`{}` pins other products of archive `{}`",
            lock::FILE,
            self.site.name
        );
        Err(StageError::new(message)
            .cause(format!(
                "it was written for `{}`, the pipeline asks for `{}`",
                pins.asked, self.asked
            ))
            .hint("run once without --locked and --offline"))
    }

    fn locked(&self, pins: &Pins) -> Result<BTreeMap<u32, Offer>, StageError> {
        let present: BTreeSet<u32> = pins.sols.keys().copied().collect();
        let chosen = self.sols.choose(&present);
        if chosen.is_empty() {
            return Err(self.nothing(&present, &format!("`{}` has", self.site.lock.display())));
        }
        let sols = pins.sols.iter().filter(|(sol, _)| chosen.contains(sol));
        Ok(sols.map(|(sol, pins)| (*sol, Offer::of_pins(pins))).collect())
    }

    /// Asks once more for records that are locked and not here: they come with the listing only.
    fn with_records(
        &self,
        ctx: &Ctx<'_>,
        mut offers: BTreeMap<u32, Offer>,
        pins: &Pins,
    ) -> Result<BTreeMap<u32, Offer>, StageError> {
        for (sol, offer) in &mut offers {
            let Some(pins) = pins.sols.get(sol) else {
                continue;
            };
            let lost = pins
                .files
                .iter()
                .filter(|(_, pin)| pin.url == lock::WITH_LISTING && ctx.get(&pin.blake3).is_err());
            let lost: Vec<(&String, &lock::Pin)> = lost.collect();
            let Some((first, _)) = lost.first() else {
                continue;
            };
            let survey = self
                .offers
                .survey(ctx, self.client()?, &Sols::Ranges(vec![(*sol, *sol)]))?;
            let changed = |name: &str| {
                StageError::new(format!(
                    "record `{name}` of sol {sol} is not what `{}` pins",
                    lock::FILE
                ))
                .cause("the feed gives it with other content now, or no longer")
                .hint("run without --locked to take what the feed gives now")
            };
            let now = survey.offers.get(sol).ok_or_else(|| changed(first))?;
            for (name, pin) in lost {
                let bytes = now.files.get(name).and_then(|offered| offered.bytes.clone());
                let bytes = bytes
                    .filter(|bytes| Digest::of(bytes) == pin.blake3)
                    .ok_or_else(|| changed(name))?;
                if let Some(offered) = offer.files.get_mut(name) {
                    offered.bytes = Some(bytes);
                }
            }
        }
        Ok(offers)
    }

    fn nothing(&self, present: &BTreeSet<u32>, who: &str) -> StageError {
        let there = match (present.first(), present.last()) {
            (Some(first), Some(last)) => format!("{who} {} sols from {first} to {last}", present.len()),
            _ => format!("{who} no sol at all"),
        };
        StageError::new(format!(
            "archive `{}` has no product of the sols asked for",
            self.site.name
        ))
        .cause(there)
        .hint("change `sols` of the archive")
    }
}

impl ArchiveFiles for Remote {
    fn list(&self, ctx: &Ctx<'_>) -> Result<Listing, StageError> {
        let offers = self.survey(ctx)?;
        let state = self.state();
        let none = SolPins::default();
        let pins = |sol: &u32| {
            state
                .pins
                .as_ref()
                .and_then(|pins| pins.sols.get(sol))
                .unwrap_or(&none)
        };
        let shards = offers.iter().map(|(sol, offer)| Shard {
            shard: *sol,
            fingerprint: offer.fingerprint(pins(sol)),
        });
        let files = offers
            .iter()
            .flat_map(|(sol, offer)| offer.files.keys().map(move |name| (sol, name)));
        let new = files
            .filter(|(sol, name)| !pins(sol).files.contains_key(*name))
            .count();
        Ok(Listing {
            shards: shards.collect(),
            note: (new > 0).then(|| format!("{new} files to fetch")),
            ..Listing::default()
        })
    }

    fn files(&self, ctx: &Ctx<'_>, shard: u32) -> Result<Vec<ArchiveFile>, StageError> {
        let listed = self.state().offers.clone();
        let offers = match listed {
            Some(offers) => offers,
            None => self.survey(ctx)?,
        };
        let offer = offers.get(&shard).ok_or_else(|| {
            StageError::new(format!(
                "archive `{}` has no sol {shard} any more",
                self.site.name
            ))
            .hint("run again: it is listed anew")
        })?;
        fetch::sol(self, ctx, shard, offer)
    }
}

impl Offer {
    /// Adds what is known from earlier: products that were here or left out and are listed no more.
    fn with_history(mut self, pins: &SolPins) -> Self {
        let listed = |name: &String| self.files.contains_key(name) || self.left_out.contains_key(name);
        let gone = |name: &String| (name.clone(), "the archive lists it no longer".to_owned());
        let labels = [".xml", ".lbl", ".json"];
        let pinned = pins
            .files
            .keys()
            .filter(|name| !labels.iter().any(|end| name.to_ascii_lowercase().ends_with(end)));
        let history: Vec<(String, String)> = pinned
            .filter(|name| !listed(name))
            .map(gone)
            .chain(
                pins.left_out
                    .iter()
                    .filter(|(name, _)| !listed(name))
                    .map(|(name, why)| (name.clone(), why.clone())),
            )
            .collect();
        self.left_out.extend(history);
        self
    }

    fn of_pins(pins: &SolPins) -> Self {
        let offered = |pin: &lock::Pin| offer::Offered {
            urls: Url::parse(&pin.url).into_iter().collect(),
            cap_bytes: pin.bytes,
            listed: pin.listed.clone(),
            bytes: None,
        };
        let files = pins.files.iter().map(|(name, pin)| (name.clone(), offered(pin)));
        Self {
            files: files.collect(),
            left_out: pins.left_out.clone(),
        }
    }

    fn fingerprint(&self, pins: &SolPins) -> Digest {
        let seen = self.files.iter().map(|(name, offered)| {
            let pin = pins.files.get(name);
            let record = offered.bytes.as_ref().map(|bytes| Digest::of(bytes));
            let is_record = record.is_some() || name.ends_with(".json");
            Seen {
                name: name.clone(),
                bytes: record.or_else(|| pin.filter(|_| is_record).map(|pin| pin.blake3)),
                others: pin
                    .map(|pin| pin.others.iter().copied().collect())
                    .unwrap_or_default(),
                changed: pin.and_then(|pin| changed(pin.listed.as_deref(), offered.listed.as_deref())),
            }
        });
        let gone = pins
            .gone
            .keys()
            .filter(|name| !self.files.contains_key(*name))
            .cloned();
        let mut names: Vec<Seen> = seen.chain(gone.map(Seen::named)).collect();
        names.sort_by(|a, b| a.name.cmp(&b.name));
        digest_of(&(names, self.left_out.clone()))
    }
}

impl Seen {
    fn named(name: String) -> Self {
        Self {
            name,
            bytes: None,
            others: Vec::new(),
            changed: None,
        }
    }
}

/// The listing's date, if it is another than that of what was fetched.
fn changed(fetched: Option<&str>, listed: Option<&str>) -> Option<String> {
    match (fetched, listed) {
        (Some(fetched), Some(listed)) if fetched != listed => Some(listed.to_owned()),
        _ => None,
    }
}

fn conduct(network: &Network, allowed: &[String]) -> Result<Conduct, ParamError> {
    let within = |key: &str, value: u64, least: u64, most: u64| {
        if (least..=most).contains(&value) {
            return Ok(());
        }
        let message = format!("{value} is not within {least} to {most}");
        Err(ParamError::new(format!("archive.network.{key}"), message))
    };
    within("connections", network.connections as u64, 1, 4)?;
    within("tries", u64::from(network.tries), 1, 10)?;
    within("delay_ms", network.delay_ms, 0, 600_000)?;
    within("retry_ms", network.retry_ms, 1, 60_000)?;
    within("stall_s", network.stall_s, 1, 3_600)?;
    let contact = network.contact.as_deref();
    if contact.is_some_and(|contact| !contact.bytes().all(|byte| (b' '..=b'~').contains(&byte))) {
        let message = "not plain ASCII".to_owned();
        return Err(ParamError::new("archive.network.contact", message));
    }
    Ok(Conduct {
        per_host: network.connections,
        delay: Duration::from_millis(network.delay_ms),
        tries: network.tries,
        first_wait: Duration::from_millis(network.retry_ms),
        stall: Duration::from_secs(network.stall_s),
        ..Conduct::polite(origins(allowed)?, contact)
    })
}

fn origins(addresses: &[String]) -> Result<Vec<Origin>, ParamError> {
    let origin = |address: &String| {
        Origin::parse(address).map_err(|error| ParamError::new("archive.base", error.to_string()))
    };
    addresses.iter().map(origin).collect()
}
