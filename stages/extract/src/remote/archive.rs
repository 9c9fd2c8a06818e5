//! An archive on a server: its catalog, and what marf.lock pins of it.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, OnceLock};

use marf_cache::Digest;
use marf_stage::{Access, Ctx, LOCK_FILE, ParamError, StageError};
use parking_lot::{Mutex, MutexGuard};

use super::catalog::{CatalogSource, SolFiles};
use super::lock::{self, Pins, SolPins};
use super::network::Network;
use crate::archive::access::RemoteContext;
use crate::net::{Client, ClientSettings};
use crate::sols::Sols;

/// An archive on a server.
pub(crate) struct RemoteArchive {
    context: RemoteContext,
    /// What the pipeline asks for beside the sols, in words; kept in marf.lock.
    asked: String,
    sols: Sols,
    settings: ClientSettings,
    source: Box<dyn CatalogSource>,
    client: OnceLock<Client>,
    state: Mutex<State>,
}

/// What a pipeline asks of a server.
pub(crate) struct Request<'a> {
    /// Kind, mission, camera and the like in words. Pins of marf.lock that were written for other words are not used.
    pub asked: String,
    /// The sols.
    pub sols: Sols,
    /// How the network is used.
    pub network: &'a Network,
    /// Addresses whose origins may be asked.
    pub allowed: &'a [String],
}

/// What was last listed, and what is pinned.
#[derive(Default)]
pub(super) struct State {
    pub sols: Option<Arc<BTreeMap<u32, SolFiles>>>,
    pub pins: Option<Pins>,
}

impl RemoteArchive {
    /// Makes the archive; nobody is asked yet.
    ///
    /// # Errors
    /// Names the key of `network` that is out of range, or the address that cannot be asked.
    pub fn new(
        context: RemoteContext,
        request: Request<'_>,
        source: Box<dyn CatalogSource>,
    ) -> Result<Self, ParamError> {
        Ok(Self {
            context,
            asked: request.asked,
            sols: request.sols,
            settings: request.network.settings(request.allowed)?,
            source,
            client: OnceLock::new(),
            state: Mutex::default(),
        })
    }

    /// Returns the name of the `[archive.*]` table.
    pub(super) fn name(&self) -> &str {
        self.context.name()
    }

    /// Returns what may be asked of the network.
    pub(super) fn access(&self) -> Access {
        self.context.access()
    }

    /// Returns the client, made at the first call.
    ///
    /// # Errors
    /// There is none under `--offline`.
    pub(super) fn client(&self) -> Result<&Client, StageError> {
        if let Some(client) = self.client.get() {
            return Ok(client);
        }
        let client = Client::new(self.context.permit()?, self.settings.clone())?;
        Ok(self.client.get_or_init(|| client))
    }

    pub(super) fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock()
    }

    /// Replaces what marf.lock pins of this archive.
    pub(super) fn write_lock(&self, pins: &Pins) -> Result<(), StageError> {
        lock::write(self.context.lock(), self.name(), pins)
    }

    /// Returns the files of the sols asked for: as the server lists them now, or as they are locked.
    ///
    /// # Errors
    /// A server that cannot be asked, a lock that cannot be read, no file of the sols asked for.
    pub(super) fn survey(&self, ctx: &Ctx<'_>) -> Result<Arc<BTreeMap<u32, SolFiles>>, StageError> {
        let pins = self.pins()?;
        let sols = match self.access() {
            Access::Online => {
                let catalog = self.source.catalog(ctx, self.client()?, &self.sols)?;
                if catalog.sols.is_empty() {
                    return Err(self.nothing(&catalog.present, "the archive has"));
                }
                let none = SolPins::default();
                let with_history = |(sol, files): (u32, SolFiles)| {
                    let files = files.with_history(pins.sols.get(&sol).unwrap_or(&none));
                    (sol, files)
                };
                catalog.sols.into_iter().map(with_history).collect()
            }
            Access::Locked => self.with_records(ctx, self.locked(&pins)?, &pins)?,
            Access::Offline => self.locked(&pins)?,
        };
        let sols = Arc::new(sols);
        let mut state = self.state();
        state.pins = Some(pins);
        state.sols = Some(Arc::clone(&sols));
        Ok(sols)
    }

    /// Returns the pins of what is asked for now. Online, pins of another camera or level are dropped.
    fn pins(&self) -> Result<Pins, StageError> {
        let pins = lock::read(self.context.lock(), self.name())?;
        if pins.asked == self.asked {
            return Ok(pins);
        }
        if self.access() == Access::Online || pins.sols.is_empty() {
            return Ok(Pins {
                asked: self.asked.clone(),
                ..Pins::default()
            });
        }
        let message = format!("`{}` pins other products of archive `{}`", LOCK_FILE, self.name());
        Err(StageError::new(message)
            .cause(format!(
                "it was written for `{}`, the pipeline asks for `{}`",
                pins.asked, self.asked
            ))
            .hint("run once without --locked and --offline"))
    }

    /// Returns what marf.lock names of the sols asked for.
    fn locked(&self, pins: &Pins) -> Result<BTreeMap<u32, SolFiles>, StageError> {
        let present: BTreeSet<u32> = pins.sols.keys().copied().collect();
        let chosen = self.sols.choose(&present);
        if chosen.is_empty() {
            return Err(self.nothing(&present, &format!("`{}` has", self.context.lock().display())));
        }
        let sols = pins.sols.iter().filter(|(sol, _)| chosen.contains(sol));
        Ok(sols.map(|(sol, pins)| (*sol, SolFiles::of_pins(pins))).collect())
    }

    /// Asks the server again for records that are locked and not in the store: they come with the listing only.
    fn with_records(
        &self,
        ctx: &Ctx<'_>,
        mut sols: BTreeMap<u32, SolFiles>,
        pins: &Pins,
    ) -> Result<BTreeMap<u32, SolFiles>, StageError> {
        for (sol, files) in &mut sols {
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
            let catalog = self
                .source
                .catalog(ctx, self.client()?, &Sols::Ranges(vec![(*sol, *sol)]))?;
            let changed = |name: &str| {
                StageError::new(format!(
                    "record `{name}` of sol {sol} is not what `{}` pins",
                    LOCK_FILE
                ))
                .cause("the feed gives it with other content now, or no longer")
                .hint("run without --locked to take what the feed gives now")
            };
            let now = catalog.sols.get(sol).ok_or_else(|| changed(first))?;
            for (name, pin) in lost {
                let bytes = now.files.get(name).and_then(|file| file.bytes.clone());
                let bytes = bytes
                    .filter(|bytes| Digest::of(bytes) == pin.blake3)
                    .ok_or_else(|| changed(name))?;
                if let Some(file) = files.files.get_mut(name) {
                    file.bytes = Some(bytes);
                }
            }
        }
        Ok(sols)
    }

    /// Returns the error that no product of the sols asked for is there; `who` is what lists the present ones.
    fn nothing(&self, present: &BTreeSet<u32>, who: &str) -> StageError {
        let there = match (present.first(), present.last()) {
            (Some(first), Some(last)) => format!("{who} {} sols from {first} to {last}", present.len()),
            _ => format!("{who} no sol at all"),
        };
        StageError::new(format!(
            "archive `{}` has no product of the sols asked for",
            self.name()
        ))
        .cause(there)
        .hint("change `sols` of the archive")
    }
}
