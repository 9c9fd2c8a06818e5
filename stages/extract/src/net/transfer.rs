//! One want: mirrors, tries, redirects, the body.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

use reqwest::header::{
    ACCEPT_ENCODING, CONTENT_ENCODING, CONTENT_LENGTH, CONTENT_RANGE, DATE, ETAG, HeaderName,
    IF_MODIFIED_SINCE, IF_NONE_MATCH, IF_RANGE, LAST_MODIFIED, LOCATION, RANGE, RETRY_AFTER,
};
use reqwest::{RequestBuilder, Response};
use tokio::time::{Instant, sleep, timeout};

use super::error::{Trouble, broken};
use super::gate::{Gate, Gates};
use super::origin::{MAX_HOPS, Origin, may_ask, redirected, shown};
use super::pace::Pace;
use super::part::{Head, Holder};
use super::policy::{Asked, Meaning, judge};
use super::{Answer, Conduct, NetError, Traffic, Url, Validators, Want, backoff, range};

/// Largest body of an answer without use that is read, to keep its connection.
const DRAIN_BYTES: u64 = 16 << 10;
/// Longest time for it.
const DRAIN_TIME: Duration = Duration::from_secs(2);

/// What all transfers of a client share.
#[derive(Debug)]
pub(super) struct Shared {
    pub conduct: Conduct,
    pub gates: Gates,
    /// Asks loopback origins; knows neither proxies nor TLS.
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
        let of = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        Traffic {
            requests: of(&self.requests),
            retries: of(&self.retries),
            resumed: of(&self.resumed),
            bytes: of(&self.bytes),
            waited: Duration::from_millis(of(&self.waited_ms)),
        }
    }
}

fn add(counter: &AtomicU64, count: u64) {
    counter.fetch_add(count, Ordering::Relaxed);
}

/// A try that brought nothing.
struct Failure {
    trouble: Trouble,
    /// What the host asked to wait.
    wait: Option<Duration>,
}

impl From<Trouble> for Failure {
    fn from(trouble: Trouble) -> Self {
        Self { trouble, wait: None }
    }
}

impl Shared {
    /// Brings a want from the first mirror that has it.
    pub(super) async fn bring(&self, want: &Want) -> Result<Answer, NetError> {
        let began = Instant::now();
        let failed = |url: Option<&Url>, trouble: Trouble| NetError {
            url: url.map_or_else(String::new, shown),
            again: trouble.may_pass_later(),
            trouble: Box::new(trouble),
            tries: 0,
            took: began.elapsed(),
            before: Vec::new(),
        };
        let Some(first) = want.urls.first() else {
            return Err(failed(None, Trouble::NoAddress));
        };
        let mut holder = Holder::open(want.part.as_deref(), want.cap_bytes)
            .map_err(|trouble| failed(Some(first), trouble))?;
        let begun = holder.body().map(|body| body.head.asked.clone());
        if holder.is_complete()
            && begun.is_some_and(|asked| want.urls.iter().any(|url| *url.as_str() == asked))
        {
            let taken = holder.taken().ok_or_else(|| failed(Some(first), Trouble::Lost));
            return taken.map(whole);
        }
        self.mirrors(want, &mut holder).await
    }

    /// Asks one mirror after the other; the one that a part is from goes first.
    async fn mirrors(&self, want: &Want, holder: &mut Holder) -> Result<Answer, NetError> {
        let begun = holder.body().map(|body| body.head.asked.clone());
        let mut order: Vec<usize> = (0..want.urls.len()).collect();
        order.sort_by_key(|place| begun.as_deref() != Some(want.urls[*place].as_str()));
        let (mut absent, mut errors) = (None, Vec::new());
        for place in order {
            let known = want.known.as_ref().filter(|_| place == 0);
            match self.mirror(&want.urls[place], known, holder).await {
                Ok(answer @ Answer::Absent { .. }) => absent = Some(answer),
                Ok(answer) => return Ok(answer),
                Err(error) => errors.push(error),
            }
        }
        match (errors.pop(), absent) {
            (Some(mut last), _) => {
                last.again |= errors.iter().any(|error| error.again);
                last.before = errors.iter().map(ToString::to_string).collect();
                Err(last)
            }
            (None, Some(absent)) => Ok(absent),
            (None, None) => Err(lost(&want.urls[0])),
        }
    }

    /// Tries one mirror until it answers or is exhausted.
    async fn mirror(
        &self,
        asked: &Url,
        known: Option<&Validators>,
        holder: &mut Holder,
    ) -> Result<Answer, NetError> {
        let began = Instant::now();
        let most = self.conduct.tries.max(1);
        let mut tries = 0;
        loop {
            tries += 1;
            let failure = match self.one_try(asked, known, holder).await {
                Ok(answer) => {
                    // Its redirect may have led to another host, which is not the one that would be blamed.
                    self.gate(asked).iter().for_each(|gate| gate.answered());
                    return Ok(answer);
                }
                Err(failure) => failure,
            };
            let settled = match &failure.trouble {
                Trouble::TooLarge { .. } => holder.discard(),
                _ => holder.settle(),
            };
            let trouble = settled.err().unwrap_or(failure.trouble);
            if !trouble.may_pass() || tries >= most {
                if let (true, Some(gate)) = (trouble.may_pass(), self.gate(asked)) {
                    gate.failed(&trouble);
                }
                return Err(NetError {
                    url: shown(asked),
                    again: trouble.may_pass_later(),
                    trouble: Box::new(trouble),
                    tries,
                    took: began.elapsed(),
                    before: Vec::new(),
                });
            }
            let jittered = backoff::wait(&self.conduct, tries, backoff::random());
            let wait = jittered.max(failure.wait.unwrap_or_default());
            add(&self.counters.waited_ms, wait.as_millis() as u64);
            sleep(wait).await;
            add(&self.counters.retries, 1);
        }
    }

    fn gate(&self, url: &Url) -> Option<std::sync::Arc<Gate>> {
        Origin::of(url).map(|origin| self.gates.of(&origin))
    }

    /// One try: the request, and those its redirects lead to.
    async fn one_try(
        &self,
        asked: &Url,
        known: Option<&Validators>,
        holder: &mut Holder,
    ) -> Result<Answer, Failure> {
        let mut url = asked.clone();
        if !may_ask(&self.conduct.allowed, &url) {
            return Err(Trouble::NotAllowed.into());
        }
        for _ in 0..=MAX_HOPS {
            let gate = self.gate(&url).ok_or(Trouble::NotAllowed)?;
            let place = gate.enter().await?;
            let (request, about) = self.request(asked, &url, known, holder)?;
            add(&self.counters.requests, 1);
            let response = timeout(self.conduct.stall, request.send())
                .await
                .map_err(|_| self.stalled(0))?
                .map_err(broken)?;
            let meaning = judge(response.status().as_u16(), about);
            if meaning == Meaning::Elsewhere {
                url = elsewhere(&self.conduct, &url, &response)?;
                drain(response, self.conduct.stall).await;
                drop(place);
                continue;
            }
            return self.answer(asked, &url, meaning, response, &gate, holder).await;
        }
        Err(Trouble::TooManyRedirects(shown(&url)).into())
    }

    /// Builds the request, with the questions that fit this address.
    fn request(
        &self,
        asked: &Url,
        url: &Url,
        known: Option<&Validators>,
        holder: &Holder,
    ) -> Result<(RequestBuilder, Asked), Trouble> {
        let secure = Origin::of(url).is_some_and(|origin| origin.is_secure());
        let client = if secure {
            self.secure.as_ref()
        } else {
            Some(&self.plain)
        };
        let mut request = client
            .ok_or(Trouble::NotAllowed)?
            .get(url.clone())
            .header(ACCEPT_ENCODING, "identity");
        let mut about = Asked {
            rest: false,
            condition: false,
        };
        if let Some((body, validator)) = holder.continues(asked, url) {
            request = request
                .header(RANGE, format!("bytes={}-", body.len()))
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

    /// Makes an answer of a response that is no redirect.
    async fn answer(
        &self,
        asked: &Url,
        url: &Url,
        meaning: Meaning,
        response: Response,
        gate: &Gate,
        holder: &mut Holder,
    ) -> Result<Answer, Failure> {
        let status = response.status().as_u16();
        match meaning {
            Meaning::Whole | Meaning::Rest => {
                if meaning == Meaning::Whole {
                    holder.restart(head(asked, url, &response))?;
                } else if let Err(trouble) = check_rest(&response, holder) {
                    holder.discard()?;
                    return Err(trouble.into());
                } else {
                    add(&self.counters.resumed, 1);
                }
                let answer = self.body(response, holder).await?;
                gate.answered();
                return Ok(answer);
            }
            Meaning::Unchanged | Meaning::Absent => {
                gate.answered();
                holder.gone(asked)?;
            }
            Meaning::Restart => holder.discard()?,
            Meaning::Forbidden => gate.refused(),
            Meaning::Again | Meaning::Final | Meaning::Elsewhere => {}
        }
        let wait = if meaning == Meaning::Again {
            asked_wait(&response)
        } else {
            None
        };
        if let Some(wait) = wait {
            gate.pause(wait);
        }
        drain(response, self.conduct.stall).await;
        match meaning {
            Meaning::Unchanged => Ok(Answer::Unchanged),
            Meaning::Absent => Ok(Answer::Absent {
                status,
                url: url.to_string(),
            }),
            _ => Err(refusal(status, wait)),
        }
    }

    /// Reads a body to its end into the holder.
    async fn body(&self, mut response: Response, holder: &mut Holder) -> Result<Answer, Trouble> {
        if let Some(encoding) = text(&response, CONTENT_ENCODING).filter(|value| *value != "identity") {
            return Err(Trouble::Encoded(super::origin::cut(encoding)));
        }
        holder.announced()?;
        let began = Instant::now();
        let mut pace = Pace::new(self.conduct.slow_after, self.conduct.slowest);
        loop {
            let at = holder.body().map_or(0, super::part::Body::len);
            let chunk = timeout(self.conduct.stall, response.chunk())
                .await
                .map_err(|_| self.stalled(at))?
                .map_err(broken)?;
            let Some(chunk) = chunk else {
                return holder.finish().map(whole);
            };
            add(&self.counters.bytes, chunk.len() as u64);
            holder.push(&chunk)?;
            if let Some(rate) = pace.came(chunk.len() as u64, began.elapsed()) {
                let slowest = self.conduct.slowest;
                return Err(Trouble::Slow { rate, slowest });
            }
        }
    }

    fn stalled(&self, at: u64) -> Trouble {
        Trouble::Stalled {
            after: self.conduct.stall,
            at,
        }
    }
}

fn whole((head, bytes): (Head, Vec<u8>)) -> Answer {
    Answer::Whole {
        bytes,
        url: head.url,
        validators: head.validators,
    }
}

/// The failure of a status; a wait that is too long ends the tries.
fn refusal(status: u16, wait: Option<Duration>) -> Failure {
    match wait.filter(|wait| *wait > backoff::LONGEST_RETRY_AFTER) {
        Some(wait) => Trouble::Later { wait }.into(),
        None => Failure {
            trouble: Trouble::Status(status),
            wait,
        },
    }
}

fn lost(url: &Url) -> NetError {
    NetError {
        url: shown(url),
        trouble: Box::new(Trouble::Lost),
        tries: 0,
        took: Duration::ZERO,
        again: false,
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

fn elsewhere(conduct: &Conduct, from: &Url, response: &Response) -> Result<Url, Trouble> {
    let location = text(response, LOCATION).ok_or(Trouble::NoLocation(response.status().as_u16()))?;
    Ok(redirected(&conduct.allowed, from, location)?)
}

/// Tells whether a 206 is the rest of what is held.
fn check_rest(response: &Response, holder: &mut Holder) -> Result<(), Trouble> {
    let body = holder.body().ok_or(Trouble::Lost)?;
    if range::differs(&body.head.validators, &validators(response)) {
        return Err(Trouble::Rest("it is of another version".into()));
    }
    let total = range::rest(text(response, CONTENT_RANGE), body.len(), body.head.length);
    holder.set_length(total.map_err(Trouble::Rest)?);
    Ok(())
}

fn asked_wait(response: &Response) -> Option<Duration> {
    let value = text(response, RETRY_AFTER)?;
    backoff::retry_after(value, text(response, DATE), SystemTime::now())
}

/// Reads a small body to its end, so that its connection can be used again; a large or slow one is cut.
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
    // Nothing hangs on it: a connection that is cut is opened again.
    let _ = timeout(stall.min(DRAIN_TIME), all).await;
}
