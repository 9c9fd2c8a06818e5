//! The blocking surface: many wants, few connections, one caller.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

use marf_stage::{Ctx, StageError};
use reqwest::redirect::Policy;
use rustls::{ClientConfig, RootCertStore};
use rustls_platform_verifier::BuilderVerifierExt;
use tokio::runtime::{Builder, Runtime};
use tokio::task::JoinHandle;

use super::error::broken;
use super::gate::Gates;
use super::origin::{Origin, shown};
use super::transfer::{Counters, Shared};
use super::{Answer, Conduct, NetError, Traffic, Trouble, Want};
use crate::archive::access::NetworkPermit;

/// How often the caller looks at the wish to stop.
const LOOK: Duration = Duration::from_millis(50);
/// Longest time that downloads get to put their parts in order when they are stopped.
const END: Duration = Duration::from_millis(1_500);
/// A connection without a request for so long is not used again: many servers close it after 5 s, and a request that
/// meets the close is lost.
const IDLE: Duration = Duration::from_secs(4);
/// Threads of the runtime: they wait, copy and hash.
const WORKERS: usize = 2;

/// Asks hosts politely. Dropping it ends what is under way; parts stay.
#[derive(Debug)]
pub(crate) struct Client {
    shared: Arc<Shared>,
    runtime: Option<Runtime>,
}

impl Client {
    /// Makes a client; no request is sent.
    ///
    /// # Errors
    /// A system without certificates to trust, threads that cannot be started.
    pub(crate) fn new(_permit: NetworkPermit, conduct: Conduct) -> Result<Self, NetError> {
        let runtime = Builder::new_multi_thread()
            .worker_threads(WORKERS)
            .thread_name("marf-net")
            .enable_all()
            .build()
            .map_err(|error| unstarted(error.to_string()))?;
        let secure = conduct.allowed.iter().any(Origin::is_secure);
        let secure = secure.then(|| secure_client(&conduct)).transpose()?;
        let shared = Shared {
            gates: Gates::new(conduct.per_host, conduct.delay),
            plain: plain_client(&conduct)?,
            secure,
            counters: Counters::default(),
            conduct,
        };
        Ok(Self {
            shared: Arc::new(shared),
            runtime: Some(runtime),
        })
    }

    /// Asks for all, at most `per_host` at a time a host; `done(index, answer)` is called on the caller's thread as
    /// each ends, in the order they end. What one want costs in memory, `cap_bytes`, may be held `per_host` times a
    /// host, and once more in `done`.
    ///
    /// # Errors
    /// [`StageError::Cancelled`] within 2 s of the wish to stop, what `done` says, two wants with one part. Parts of
    /// what was under way stay, and the next call goes on from them. A want that fails is no error here.
    pub(crate) fn get_all(
        &self,
        ctx: &Ctx<'_>,
        wants: &[Want],
        done: &mut dyn FnMut(usize, Result<Answer, NetError>) -> Result<(), StageError>,
    ) -> Result<(), StageError> {
        distinct_parts(wants)?;
        let runtime = self.runtime.as_ref().ok_or_else(|| StageError::from(lost()))?;
        let mut round = Round::new(&self.shared, runtime, wants);
        round.fill();
        while !round.under_way.is_empty() {
            ctx.check()?;
            match round.reports.recv_timeout(LOOK) {
                Ok((index, answer)) => {
                    round.ended(index);
                    done(index, answer)?;
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Err(lost().into()),
            }
        }
        ctx.check()
    }

    /// What was asked since the client was made.
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

type Reported = (usize, Result<Answer, NetError>);

/// One call of `get_all`: what waits, by the host it asks first, and what is under way.
struct Round<'a> {
    shared: &'a Arc<Shared>,
    runtime: &'a Runtime,
    wants: &'a [Want],
    waiting: BTreeMap<String, VecDeque<usize>>,
    under_way: BTreeMap<usize, (String, JoinHandle<()>)>,
    reporter: Option<Sender<Reported>>,
    reports: Receiver<Reported>,
}

impl<'a> Round<'a> {
    fn new(shared: &'a Arc<Shared>, runtime: &'a Runtime, wants: &'a [Want]) -> Self {
        let mut waiting: BTreeMap<String, VecDeque<usize>> = BTreeMap::new();
        for (index, want) in wants.iter().enumerate() {
            let origin = want.urls.first().and_then(Origin::of);
            let host = origin.map_or_else(String::new, |origin| origin.authority());
            waiting.entry(host).or_default().push_back(index);
        }
        let (reporter, reports) = mpsc::channel();
        Self {
            shared,
            runtime,
            wants,
            waiting,
            under_way: BTreeMap::new(),
            reporter: Some(reporter),
            reports,
        }
    }

    /// Starts what each host has room for.
    fn fill(&mut self) {
        let hosts: Vec<String> = self.waiting.keys().cloned().collect();
        for host in hosts {
            (0..self.shared.conduct.per_host.max(1)).for_each(|_| self.start(&host));
        }
    }

    /// Starts the next want of a host, if there is one.
    fn start(&mut self, host: &str) {
        let next = self.waiting.get_mut(host).and_then(VecDeque::pop_front);
        let (Some(index), Some(reporter)) = (next, &self.reporter) else {
            return;
        };
        let (shared, want) = (Arc::clone(self.shared), self.wants[index].clone());
        let report = Report {
            index,
            url: want.urls.first().map_or_else(String::new, shown),
            reporter: Some(reporter.clone()),
        };
        let task = self.runtime.spawn(async move {
            let answer = shared.bring(&want).await;
            report.send(answer);
        });
        self.under_way.insert(index, (host.to_owned(), task));
    }

    fn ended(&mut self, index: usize) {
        if let Some((host, _)) = self.under_way.remove(&index) {
            self.start(&host);
        }
    }
}

/// Stops what is under way and waits, for a while, until its parts are in order.
impl Drop for Round<'_> {
    fn drop(&mut self) {
        self.under_way.values().for_each(|(_, task)| task.abort());
        self.reporter = None;
        let began = Instant::now();
        while let Some(left) = END.checked_sub(began.elapsed()) {
            if let Err(RecvTimeoutError::Disconnected | RecvTimeoutError::Timeout) =
                self.reports.recv_timeout(left)
            {
                break;
            }
        }
    }
}

/// Tells the caller how one want ended, also where its task panicked.
struct Report {
    index: usize,
    url: String,
    reporter: Option<Sender<Reported>>,
}

impl Report {
    fn send(mut self, answer: Result<Answer, NetError>) {
        if let Some(reporter) = self.reporter.take() {
            // The caller may have stopped listening.
            let _ = reporter.send((self.index, answer));
        }
    }
}

impl Drop for Report {
    fn drop(&mut self) {
        if let Some(reporter) = self.reporter.take() {
            let error = NetError {
                url: std::mem::take(&mut self.url),
                ..lost()
            };
            let _ = reporter.send((self.index, Err(error)));
        }
    }
}

fn distinct_parts(wants: &[Want]) -> Result<(), StageError> {
    let mut seen = BTreeSet::new();
    match wants
        .iter()
        .filter_map(|want| want.part.as_deref())
        .find(|part| !seen.insert(*part))
    {
        Some(part) => Err(StageError::new(format!(
            "two downloads would share the part `{}`",
            part.display()
        ))),
        None => Ok(()),
    }
}

fn basic(conduct: &Conduct) -> reqwest::ClientBuilder {
    reqwest::Client::builder()
        .user_agent(&conduct.agent)
        .redirect(Policy::none())
        .retry(reqwest::retry::never())
        .referer(false)
        .connect_timeout(conduct.stall)
        .pool_max_idle_per_host(conduct.per_host)
        .pool_idle_timeout(IDLE)
}

/// Trusts nobody and knows no proxy: for loopback origins, which are asked without TLS.
fn plain_client(conduct: &Conduct) -> Result<reqwest::Client, NetError> {
    let nobody = tls()?
        .with_root_certificates(RootCertStore::empty())
        .with_no_client_auth();
    let client = basic(conduct).no_proxy().tls_backend_preconfigured(nobody);
    client.build().map_err(unbuilt)
}

/// Trusts whom the system trusts, and goes through the proxy of the environment.
fn secure_client(conduct: &Conduct) -> Result<reqwest::Client, NetError> {
    let config = tls()?
        .with_platform_verifier()
        .map_err(|error| unstarted(error.to_string()))?
        .with_no_client_auth();
    let client = basic(conduct).https_only(true).tls_backend_preconfigured(config);
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
        trouble: Box::new(Trouble::Unstarted(why)),
        ..lost()
    }
}

fn lost() -> NetError {
    NetError {
        url: "the client".to_owned(),
        trouble: Box::new(Trouble::Lost),
        tries: 0,
        took: Duration::ZERO,
        again: false,
        before: Vec::new(),
    }
}
