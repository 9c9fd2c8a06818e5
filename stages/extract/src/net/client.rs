//! The blocking interface: many downloads, few connections, one caller.

use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use marf_stage::{Cancel, StageError};
use reqwest::redirect::Policy;
use rustls::{ClientConfig, RootCertStore};
use rustls_platform_verifier::BuilderVerifierExt;
use tokio::runtime::{Builder, Runtime};
use tokio::task::{Id, JoinSet};
use tokio::time::timeout;

use super::error::broken;
use super::limiter::HostLimiters;
use super::origin::{Origin, shown};
use super::transfer::{Counters, Shared};
use super::{Answer, ClientSettings, Download, NetError, NetErrorKind, Traffic};
use crate::archive::access::NetworkPermit;

/// How often the caller checks the wish to stop.
const CHECK: Duration = Duration::from_millis(50);
/// Longest time that downloads get to finish their parts when they are stopped.
const GRACE: Duration = Duration::from_millis(1_500);
/// A connection without a request for so long is not used retryable: many servers close it after 5 s, and a request that
/// meets the close is lost.
const IDLE: Duration = Duration::from_secs(4);
/// Threads of the runtime: they wait, copy and hash.
const WORKERS: usize = 2;

/// Downloads files, few at a time from one host. Dropping it cancels running downloads. Their parts stay.
#[derive(Debug)]
pub(crate) struct Client {
    shared: Arc<Shared>,
    runtime: Option<Runtime>,
}

impl Client {
    /// Makes a client. No request is sent.
    ///
    /// # Errors
    /// A system without certificates to trust, threads that cannot be started.
    pub(crate) fn new(_permit: NetworkPermit, settings: ClientSettings) -> Result<Self, NetError> {
        let runtime = Builder::new_multi_thread()
            .worker_threads(WORKERS)
            .thread_name("marf-net")
            .enable_all()
            .build()
            .map_err(|error| unstarted(error.to_string()))?;
        let secure = settings.allowed.iter().any(Origin::is_secure);
        let secure = secure.then(|| secure_client(&settings)).transpose()?;
        let shared = Shared {
            limiters: HostLimiters::new(settings.per_host, settings.delay),
            plain: plain_client(&settings)?,
            secure,
            counters: Counters::default(),
            settings,
        };
        Ok(Self {
            shared: Arc::new(shared),
            runtime: Some(runtime),
        })
    }

    /// Downloads all, at most `per_host` at a time a host. `done(index, answer)` is called on the caller's thread as
    /// each ends, in the order they end. The memory of one download is `cap_bytes`. It may be held `per_host` times a
    /// host, and once more in `done`.
    ///
    /// # Errors
    /// [`StageError::Cancelled`] within 2 s of a requested stop, errors of `done`, two downloads with one part. Parts
    /// of running downloads stay, and the next call continues them. A download that fails is not an error here.
    pub(crate) fn get_all(
        &self,
        cancel: &Cancel,
        downloads: &[Download],
        done: &mut dyn FnMut(usize, Result<Answer, NetError>) -> Result<(), StageError>,
    ) -> Result<(), StageError> {
        distinct_parts(downloads)?;
        let runtime = self.runtime.as_ref().ok_or_else(|| StageError::from(lost()))?;
        let mut batch = Batch::new(&self.shared, runtime, downloads);
        while !batch.under_way.is_empty() {
            go_on(cancel)?;
            if let Some((index, answer)) = batch.next_ended() {
                done(index, answer)?;
            }
        }
        go_on(cancel)
    }

    /// Returns the traffic since the client was made.
    pub(crate) fn traffic(&self) -> Traffic {
        self.shared.counters.read()
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        // Not waited for: a name that is being resolved can hold a thread for half a minute.
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

fn go_on(cancel: &Cancel) -> Result<(), StageError> {
    if cancel.is_set() {
        return Err(StageError::Cancelled);
    }
    Ok(())
}

/// One call of `get_all`: waiting downloads by the host of their first request, and running downloads.
struct Batch<'a> {
    shared: &'a Arc<Shared>,
    runtime: &'a Runtime,
    downloads: &'a [Download],
    waiting: BTreeMap<String, VecDeque<usize>>,
    under_way: JoinSet<Result<Answer, NetError>>,
    /// Host and number of the running downloads.
    places: HashMap<Id, (String, usize)>,
}

impl<'a> Batch<'a> {
    /// Starts as many downloads as each host may have at once.
    fn new(shared: &'a Arc<Shared>, runtime: &'a Runtime, downloads: &'a [Download]) -> Self {
        let mut waiting: BTreeMap<String, VecDeque<usize>> = BTreeMap::new();
        for (index, download) in downloads.iter().enumerate() {
            let origin = download.urls.first().and_then(Origin::from_url);
            let host = origin.map_or_else(String::new, |origin| origin.authority());
            waiting.entry(host).or_default().push_back(index);
        }
        let hosts: Vec<String> = waiting.keys().cloned().collect();
        let mut batch = Self {
            shared,
            runtime,
            downloads,
            waiting,
            under_way: JoinSet::new(),
            places: HashMap::new(),
        };
        for host in hosts {
            (0..shared.settings.per_host.max(1)).for_each(|_| batch.start(&host));
        }
        batch
    }

    /// Starts the next download of a host, if there is one.
    fn start(&mut self, host: &str) {
        let Some(index) = self.waiting.get_mut(host).and_then(VecDeque::pop_front) else {
            return;
        };
        let (shared, download) = (Arc::clone(self.shared), self.downloads[index].clone());
        let running = async move { shared.download(&download).await };
        let task = self.under_way.spawn_on(running, self.runtime.handle());
        self.places.insert(task.id(), (host.to_owned(), index));
    }

    /// Waits, for a moment, until a download ends, and starts the next one of its host.
    fn next_ended(&mut self) -> Option<(usize, Result<Answer, NetError>)> {
        let ended = async { timeout(CHECK, self.under_way.join_next_with_id()).await };
        let (id, answer) = match self.runtime.block_on(ended).ok()?? {
            Ok((id, answer)) => (id, Some(answer)),
            Err(panicked) => (panicked.id(), None),
        };
        let (host, index) = self.places.remove(&id)?;
        self.start(&host);
        let url = || self.downloads[index].urls.first().map_or_else(String::new, shown);
        let answer = answer.unwrap_or_else(|| Err(NetError { url: url(), ..lost() }));
        Some((index, answer))
    }
}

/// Stops running downloads and waits, for a while, until their parts are finished.
impl Drop for Batch<'_> {
    fn drop(&mut self) {
        let stopped = async { timeout(GRACE, self.under_way.shutdown()).await };
        // What has not finished by then is still stopped.
        let _ = self.runtime.block_on(stopped);
    }
}

fn distinct_parts(downloads: &[Download]) -> Result<(), StageError> {
    let mut seen = BTreeSet::new();
    match downloads
        .iter()
        .filter_map(|download| download.part.as_deref())
        .find(|part| !seen.insert(*part))
    {
        Some(part) => Err(StageError::new(format!(
            "two downloads would share the part `{}`",
            part.display()
        ))),
        None => Ok(()),
    }
}

fn basic(settings: &ClientSettings) -> reqwest::ClientBuilder {
    reqwest::Client::builder()
        .user_agent(&settings.agent)
        .redirect(Policy::none())
        .retry(reqwest::retry::never())
        .referer(false)
        .connect_timeout(settings.stall)
        .pool_max_idle_per_host(settings.per_host)
        .pool_idle_timeout(IDLE)
}

/// Returns a client without certificates and proxies: for loopback origins, which are asked without TLS.
fn plain_client(settings: &ClientSettings) -> Result<reqwest::Client, NetError> {
    let nobody = tls()?
        .with_root_certificates(RootCertStore::empty())
        .with_no_client_auth();
    let client = basic(settings).no_proxy().tls_backend_preconfigured(nobody);
    client.build().map_err(unbuilt)
}

/// Returns a client that trusts the certificates of the system, and uses the proxy of the environment.
fn secure_client(settings: &ClientSettings) -> Result<reqwest::Client, NetError> {
    let config = tls()?
        .with_platform_verifier()
        .map_err(|error| unstarted(error.to_string()))?
        .with_no_client_auth();
    let client = basic(settings).https_only(true).tls_backend_preconfigured(config);
    client.build().map_err(unbuilt)
}

fn tls() -> Result<rustls::ConfigBuilder<ClientConfig, rustls::WantsVerifier>, NetError> {
    ClientConfig::builder_with_provider(Arc::new(rustls::crypto::ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|error| unstarted(error.to_string()))
}

fn unbuilt(error: reqwest::Error) -> NetError {
    unstarted(broken(error).to_string())
}

fn unstarted(why: String) -> NetError {
    NetError {
        kind: Box::new(NetErrorKind::Unstarted(why)),
        ..lost()
    }
}

fn lost() -> NetError {
    NetError {
        url: "the client".to_owned(),
        kind: Box::new(NetErrorKind::Lost),
        tries: 0,
        took: Duration::ZERO,
        retryable: false,
        before: Vec::new(),
    }
}
