//! One download: mirrors, tries, redirects, the body.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

use reqwest::header::{
    ACCEPT_ENCODING, CONTENT_ENCODING, CONTENT_LENGTH, CONTENT_RANGE, DATE, ETAG, HeaderName,
    IF_MODIFIED_SINCE, IF_NONE_MATCH, IF_RANGE, LAST_MODIFIED, LOCATION, RANGE, RETRY_AFTER,
};
use reqwest::{RequestBuilder, Response};
use tokio::time::{Instant, sleep, timeout};

use super::error::{NetErrorKind, broken};
use super::limiter::{HostLimiter, HostLimiters};
use super::origin::{MAX_HOPS, Origin, may_ask, redirected, shown};
use super::part::{Head, PartialDownload};
use super::rate::RateMonitor;
use super::status::{Asked, StatusClass, classify};
use super::{Answer, ClientSettings, Download, NetError, Traffic, Url, Validators, backoff, range};

/// Largest body of an unused answer that is read, so that its connection can be used again.
const DRAIN_BYTES: u64 = 16 << 10;
/// Longest time for that.
const DRAIN_TIME: Duration = Duration::from_secs(2);

/// What all transfers of a client share.
#[derive(Debug)]
pub(super) struct Shared {
    pub settings: ClientSettings,
    pub limiters: HostLimiters,
    /// For loopback origins, without proxies and TLS.
    pub plain: reqwest::Client,
    /// Asks everything else.
    pub secure: Option<reqwest::Client>,
    pub counters: Counters,
}

/// Counts of [`Traffic`].
#[derive(Debug, Default)]
pub(super) struct Counters {
    requests: AtomicU64,
    retries: AtomicU64,
    resumed: AtomicU64,
    bytes: AtomicU64,
    waited_ms: AtomicU64,
}

impl Counters {
    pub(super) fn read(&self) -> Traffic {
        let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        Traffic {
            requests: count(&self.requests),
            retries: count(&self.retries),
            resumed: count(&self.resumed),
            bytes: count(&self.bytes),
            waited: Duration::from_millis(count(&self.waited_ms)),
        }
    }
}

fn add(counter: &AtomicU64, count: u64) {
    counter.fetch_add(count, Ordering::Relaxed);
}

/// A failed try.
struct Failure {
    kind: NetErrorKind,
    /// What the host asked to wait.
    wait: Option<Duration>,
}

impl From<NetErrorKind> for Failure {
    fn from(kind: NetErrorKind) -> Self {
        Self { kind, wait: None }
    }
}

impl Shared {
    /// Downloads from the first mirror that has the file.
    pub(super) async fn download(&self, download: &Download) -> Result<Answer, NetError> {
        let began = Instant::now();
        let failed = |url: Option<&Url>, kind: NetErrorKind| NetError {
            url: url.map_or_else(String::new, shown),
            retryable: kind.worth_another_run(),
            kind: Box::new(kind),
            tries: 0,
            took: began.elapsed(),
            before: Vec::new(),
        };
        let Some(first) = download.urls.first() else {
            return Err(failed(None, NetErrorKind::NoAddress));
        };
        let mut partial = PartialDownload::open(download.part.as_deref(), download.cap_bytes)
            .map_err(|kind| failed(Some(first), kind))?;
        let begun = partial.body().map(|body| body.head.asked.clone());
        if partial.is_complete()
            && begun.is_some_and(|asked| download.urls.iter().any(|url| *url.as_str() == asked))
        {
            let taken = partial
                .taken()
                .ok_or_else(|| failed(Some(first), NetErrorKind::Lost));
            return taken.map(|(head, bytes)| whole(head, bytes));
        }
        self.mirrors(download, &mut partial).await
    }

    /// Tries one mirror after the other. The one that the part came from goes first.
    async fn mirrors(&self, download: &Download, partial: &mut PartialDownload) -> Result<Answer, NetError> {
        let begun = partial.body().map(|body| body.head.asked.clone());
        let mut order: Vec<usize> = (0..download.urls.len()).collect();
        order.sort_by_key(|place| begun.as_deref() != Some(download.urls[*place].as_str()));
        let (mut absent, mut errors) = (None, Vec::new());
        for place in order {
            let known = download.known.as_ref().filter(|_| place == 0);
            match self.mirror(&download.urls[place], known, partial).await {
                Ok(answer @ Answer::Absent { .. }) => absent = Some(answer),
                Ok(answer) => return Ok(answer),
                Err(error) => errors.push(error),
            }
        }
        match (errors.pop(), absent) {
            (Some(mut last), _) => {
                last.retryable |= errors.iter().any(|error| error.retryable);
                last.before = errors.iter().map(ToString::to_string).collect();
                Err(last)
            }
            (None, Some(absent)) => Ok(absent),
            (None, None) => Err(lost(&download.urls[0])),
        }
    }

    /// Tries one mirror until it answers or is exhausted.
    async fn mirror(
        &self,
        asked: &Url,
        known: Option<&Validators>,
        partial: &mut PartialDownload,
    ) -> Result<Answer, NetError> {
        let began = Instant::now();
        let most = self.settings.tries.max(1);
        let mut tries = 0;
        loop {
            tries += 1;
            let failure = match self.one_try(asked, known, partial).await {
                Ok(answer) => {
                    // Its redirect may have led to another host, which is not the one that would be blamed.
                    self.limiter(asked).iter().for_each(|limiter| limiter.answered());
                    return Ok(answer);
                }
                Err(failure) => failure,
            };
            let settled = match &failure.kind {
                NetErrorKind::TooLarge { .. } | NetErrorKind::Rest(_) => partial.discard(),
                _ => partial.settle(),
            };
            let kind = settled.err().unwrap_or(failure.kind);
            if !kind.worth_another_try() || tries >= most {
                let limiter = self.limiter(asked).filter(|_| kind.worth_another_try());
                limiter.iter().for_each(|limiter| limiter.failed(&kind));
                return Err(NetError {
                    url: shown(asked),
                    retryable: kind.worth_another_run(),
                    kind: Box::new(kind),
                    tries,
                    took: began.elapsed(),
                    before: Vec::new(),
                });
            }
            let jittered = backoff::wait(&self.settings, tries, backoff::random());
            let wait = jittered.max(failure.wait.unwrap_or_default());
            add(&self.counters.waited_ms, wait.as_millis() as u64);
            sleep(wait).await;
            add(&self.counters.retries, 1);
        }
    }

    fn limiter(&self, url: &Url) -> Option<std::sync::Arc<HostLimiter>> {
        Origin::from_url(url).map(|origin| self.limiters.limiter(&origin))
    }

    /// Sends the request, and those that its redirects lead to.
    async fn one_try(
        &self,
        asked: &Url,
        known: Option<&Validators>,
        partial: &mut PartialDownload,
    ) -> Result<Answer, Failure> {
        let mut url = asked.clone();
        if !may_ask(&self.settings.allowed, &url) {
            return Err(NetErrorKind::NotAllowed.into());
        }
        for _ in 0..=MAX_HOPS {
            let limiter = self.limiter(&url).ok_or(NetErrorKind::NotAllowed)?;
            let place = limiter.enter().await?;
            let (request, about) = self.request(asked, &url, known, partial)?;
            add(&self.counters.requests, 1);
            let response = timeout(self.settings.stall, request.send())
                .await
                .map_err(|_| self.stalled(0))?
                .map_err(broken)?;
            let class = classify(response.status().as_u16(), about);
            if class == StatusClass::Elsewhere {
                url = elsewhere(&self.settings, &url, &response)?;
                drain(response, self.settings.stall).await;
                drop(place);
                continue;
            }
            return self.answer(asked, &url, class, response, partial).await;
        }
        Err(NetErrorKind::TooManyRedirects(shown(&url)).into())
    }

    /// Builds the request, with the conditions that fit this address.
    fn request(
        &self,
        asked: &Url,
        url: &Url,
        known: Option<&Validators>,
        partial: &PartialDownload,
    ) -> Result<(RequestBuilder, Asked), NetErrorKind> {
        let secure = Origin::from_url(url).is_some_and(|origin| origin.is_secure());
        let client = if secure {
            self.secure.as_ref()
        } else {
            Some(&self.plain)
        };
        let mut request = client
            .ok_or(NetErrorKind::NotAllowed)?
            .get(url.clone())
            .header(ACCEPT_ENCODING, "identity");
        let mut about = Asked {
            rest: false,
            condition: false,
        };
        if let Some((body, validator)) = partial.continues(asked, url) {
            request = request
                .header(RANGE, format!("bytes={}-", body.rest_from()))
                .header(IF_RANGE, validator);
            about.rest = true;
        }
        let etag = known.and_then(|known| range::validator(known.etag.as_deref()));
        let modified = known.and_then(|known| range::validator(known.modified.as_deref()));
        if let Some(etag) = etag {
            request = request.header(IF_NONE_MATCH, etag);
            about.condition = true;
        } else if let Some(modified) = modified {
            request = request.header(IF_MODIFIED_SINCE, modified);
            about.condition = true;
        }
        Ok((request, about))
    }

    /// Returns the answer of a response that is not a redirect.
    async fn answer(
        &self,
        asked: &Url,
        url: &Url,
        class: StatusClass,
        response: Response,
        partial: &mut PartialDownload,
    ) -> Result<Answer, Failure> {
        let limiter = self.limiter(url).ok_or(NetErrorKind::NotAllowed)?;
        let status = response.status().as_u16();
        match class {
            StatusClass::Whole | StatusClass::Rest => {
                if class == StatusClass::Whole {
                    partial.restart(head(asked, url, &response))?;
                } else {
                    check_rest(&response, partial)?;
                    add(&self.counters.resumed, 1);
                }
                let answer = self.body(response, partial).await?;
                limiter.answered();
                return Ok(answer);
            }
            StatusClass::Unchanged | StatusClass::Absent => {
                limiter.answered();
                partial.gone(asked)?;
            }
            StatusClass::Restart => partial.discard()?,
            StatusClass::Forbidden => limiter.refused(),
            StatusClass::Again | StatusClass::Final | StatusClass::Elsewhere => {}
        }
        let wait = if class == StatusClass::Again {
            asked_wait(&response)
        } else {
            None
        };
        if let Some(wait) = wait {
            limiter.pause(wait);
        }
        drain(response, self.settings.stall).await;
        match class {
            StatusClass::Unchanged => Ok(Answer::Unchanged),
            StatusClass::Absent => Ok(Answer::Absent {
                status,
                url: url.to_string(),
            }),
            _ => Err(refusal(status, wait)),
        }
    }

    /// Reads a body to its end.
    async fn body(
        &self,
        mut response: Response,
        partial: &mut PartialDownload,
    ) -> Result<Answer, NetErrorKind> {
        if let Some(encoding) = text(&response, CONTENT_ENCODING).filter(|value| *value != "identity") {
            return Err(NetErrorKind::Encoded(super::origin::cut(encoding)));
        }
        partial.announced()?;
        let began = Instant::now();
        let mut pace = RateMonitor::new(self.settings.slow_after, self.settings.slowest);
        loop {
            let at = partial.body().map_or(0, super::part::Body::len);
            let chunk = timeout(self.settings.stall, response.chunk())
                .await
                .map_err(|_| self.stalled(at))?
                .map_err(broken)?;
            let Some(chunk) = chunk else {
                return partial.finish().map(|(head, bytes)| whole(head, bytes));
            };
            add(&self.counters.bytes, chunk.len() as u64);
            partial.push(&chunk)?;
            if let Some(rate) = pace.came(chunk.len() as u64, began.elapsed()) {
                let slowest = self.settings.slowest;
                return Err(NetErrorKind::Slow { rate, slowest });
            }
        }
    }

    fn stalled(&self, at: u64) -> NetErrorKind {
        NetErrorKind::Stalled {
            after: self.settings.stall,
            at,
        }
    }
}

fn whole(head: Head, bytes: Vec<u8>) -> Answer {
    Answer::Whole {
        bytes,
        url: head.url,
        validators: head.validators,
    }
}

/// Returns the failure of a status. A wait that is too long ends the tries.
fn refusal(status: u16, wait: Option<Duration>) -> Failure {
    match wait.filter(|wait| *wait > backoff::LONGEST_RETRY_AFTER) {
        Some(wait) => NetErrorKind::Later { wait }.into(),
        None => Failure {
            kind: NetErrorKind::Status(status),
            wait,
        },
    }
}

fn lost(url: &Url) -> NetError {
    NetError {
        url: shown(url),
        kind: Box::new(NetErrorKind::Lost),
        tries: 0,
        took: Duration::ZERO,
        retryable: false,
        before: Vec::new(),
    }
}

fn text(response: &Response, name: HeaderName) -> Option<&str> {
    response.headers().get(name)?.to_str().ok()
}

fn validators(response: &Response) -> Validators {
    Validators {
        etag: range::validator(text(response, ETAG)),
        modified: range::validator(text(response, LAST_MODIFIED)),
    }
}

fn head(asked: &Url, url: &Url, response: &Response) -> Head {
    Head {
        asked: asked.to_string(),
        url: url.to_string(),
        validators: validators(response),
        length: text(response, CONTENT_LENGTH).and_then(|length| length.parse().ok()),
    }
}

fn elsewhere(settings: &ClientSettings, from: &Url, response: &Response) -> Result<Url, NetErrorKind> {
    let location = text(response, LOCATION).ok_or(NetErrorKind::NoLocation(response.status().as_u16()))?;
    Ok(redirected(&settings.allowed, from, location)?)
}

/// Checks that a 206 is the rest of the held body.
fn check_rest(response: &Response, partial: &mut PartialDownload) -> Result<(), NetErrorKind> {
    let body = partial.body().ok_or(NetErrorKind::Lost)?;
    if range::differs(&body.head.validators, &validators(response)) {
        return Err(NetErrorKind::Rest("it is of another version".into()));
    }
    let from = body.rest_from();
    let total = range::rest(text(response, CONTENT_RANGE), from, body.head.length);
    partial.resume(total.map_err(NetErrorKind::Rest)?);
    Ok(())
}

fn asked_wait(response: &Response) -> Option<Duration> {
    let value = text(response, RETRY_AFTER)?;
    backoff::retry_after(value, text(response, DATE), SystemTime::now())
}

/// Reads a small body to its end, so that its connection can be used again. A large or slow one is cut.
async fn drain(mut response: Response, stall: Duration) {
    let mut read = 0;
    let all = async {
        while let Ok(Some(chunk)) = response.chunk().await {
            read += chunk.len() as u64;
            if read > DRAIN_BYTES {
                break;
            }
        }
    };
    // Where that fails, the next request opens a new connection.
    let _ = timeout(stall.min(DRAIN_TIME), all).await;
}
