//! Answers to the addresses of the site.

use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::{Body, Bytes, to_bytes};
use axum::extract::{Path, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::sse::{KeepAlive, Sse};
use axum::response::{IntoResponse as _, Response};
use axum::routing::{get, post};
use futures_util::{StreamExt as _, stream};
use marf_cache::Digest;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::access::Refusal;
use crate::answers::{HTML, JSON, answer, file, json, redirect, refusal};
use crate::content::{BYTES, made_now};
use crate::difference::Reference;
use crate::events::follow;
use crate::field::SharedField;
use crate::frames::{FrameError, Shown, View};
use crate::measure::{distance, pick};
use crate::site::Site;
use crate::splats::{SplatState, pack, splats_of_points};
use crate::stream::received;

/// Most bytes of a request: a view has some hundred.
const MOST_BODY_BYTES: usize = 16 << 10;
/// Longest time for them.
const BODY_TIME: Duration = Duration::from_secs(10);

/// Content security policy: a page reads only from here, has no script or style in it, and no frame around
/// it.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; media-src 'self'; \
    connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Returns all routes below a prefix.
pub fn routes(site: Arc<Site>, prefix: &str) -> Router {
    let at = |path: &str| format!("{prefix}{path}");
    let fixed = |media: &'static str, text: &'static str| get(move || async move { answer(media, text) });
    let script = |text: &'static str| fixed("text/javascript; charset=utf-8", text);
    let mut routes = Router::new()
        .route(&at("/"), get(page))
        .route(&at("/live.js"), script(include_str!("page/live.js")))
        .route(&at("/mover.js"), script(include_str!("page/mover.js")))
        .route(&at("/view.js"), script(include_str!("page/view.js")))
        .route(&at("/pictures.js"), script(include_str!("page/pictures.js")))
        .route(&at("/projector.js"), script(include_str!("page/projector.js")))
        .route(&at("/splats.js"), script(include_str!("page/splats.js")))
        .route(
            &at("/view.css"),
            fixed("text/css; charset=utf-8", include_str!("page/view.css")),
        )
        .route(
            &at("/icon.svg"),
            fixed("image/svg+xml", include_str!("page/icon.svg")),
        )
        .route(&at("/pages/{name}"), get(scene_page))
        .route(&at("/events"), get(events))
        .route(&at("/object/{digest}"), get(object))
        .route(&at("/scene/{run}/{field}"), get(scene))
        .route(&at("/points/{run}/{field}"), get(points))
        .route(&at("/splats/{run}/{field}"), get(splats))
        .route(&at("/photo/{run}/{field}/{digest}"), get(photo))
        .route(&at("/frames"), post(frames))
        .route(&at("/pick"), post(picked))
        .route(&at("/distance"), post(measured));
    if !prefix.is_empty() {
        // Relative addresses of the page need the slash.
        let to = at("/");
        routes = routes.route(prefix, get(move || std::future::ready(redirect(&to))));
    }
    routes
        .fallback(|| async { refusal(StatusCode::NOT_FOUND, "there is nothing at this address") })
        .layer(middleware::from_fn_with_state(
            (Arc::clone(&site), prefix.to_owned()),
            guard,
        ))
        .with_state(site)
}

/// Checks every request, and says in every answer what a page may do with it.
async fn guard(State((site, prefix)): State<(Arc<Site>, String)>, request: Request, next: Next) -> Response {
    let mut response = match entrance(&site, &prefix, &request) {
        Some(response) => response,
        None => match site.access.check(request.method(), request.headers()) {
            Ok(()) => match whole(request).await {
                Ok(request) => next.run(request).await,
                Err(status) => refusal(status, "the body of the request is too large or too slow"),
            },
            Err(refused) => {
                let status = match refused {
                    Refusal::Token => StatusCode::UNAUTHORIZED,
                    Refusal::Host | Refusal::Origin => StatusCode::FORBIDDEN,
                };
                refusal(status, refused.message())
            }
        },
    };
    let set = |name: HeaderName, value: &'static str| (name, HeaderValue::from_static(value));
    response.headers_mut().extend([
        set(header::CONTENT_SECURITY_POLICY, POLICY),
        set(header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        set(header::REFERRER_POLICY, "no-referrer"),
        set(
            HeaderName::from_static("cross-origin-resource-policy"),
            "same-origin",
        ),
        set(
            HeaderName::from_static("cross-origin-opener-policy"),
            "same-origin",
        ),
    ]);
    response
}

/// Reads the body of a request, which is small and sent at once.
async fn whole(request: Request) -> Result<Request, StatusCode> {
    let (head, body) = request.into_parts();
    let read = tokio::time::timeout(BODY_TIME, to_bytes(body, MOST_BODY_BYTES)).await;
    let bytes = read
        .map_err(|_| StatusCode::REQUEST_TIMEOUT)?
        .map_err(|_| StatusCode::PAYLOAD_TOO_LARGE)?;
    Ok(Request::from_parts(head, Body::from(bytes)))
}

/// Answers the address that `marf view` printed, which holds the token: a cookie takes its place.
fn entrance(site: &Site, prefix: &str, request: &Request) -> Option<Response> {
    let token = request.uri().query()?.strip_prefix("token=")?;
    let is_let_in = request.method() == Method::GET
        && site.access.check_host(request.headers()).is_ok()
        && site.access.is_token(token);
    if !is_let_in {
        return None;
    }
    let cookie = format!("{}={token}; HttpOnly; SameSite=Strict", site.access.cookie_name());
    // Relative to the prefix without its slash, `./` is the folder above it.
    let page = if request.uri().path() == prefix {
        format!("{prefix}/")
    } else {
        "./".to_owned()
    };
    let mut response = redirect(&page);
    response
        .headers_mut()
        .insert(header::SET_COOKIE, cookie.parse().ok()?);
    Some(response)
}

async fn page(State(site): State<Arc<Site>>) -> Response {
    match blocking(move || site.refreshed()).await {
        Ok(content) => answer(HTML, content.page.html.clone()),
        Err(message) => refusal(StatusCode::INTERNAL_SERVER_ERROR, &message),
    }
}

async fn scene_page(State(site): State<Arc<Site>>, Path(name): Path<String>) -> Response {
    let read = move || {
        let pages = site
            .contents()
            .into_iter()
            .map(|content| content.scene_page(site.source.as_ref(), &name));
        first_good(pages, "no run is shown")
    };
    match blocking(read).await {
        Ok(page) => answer(HTML, page.html.clone()),
        Err(message) => refusal(StatusCode::NOT_FOUND, &message),
    }
}

async fn events(State(site): State<Arc<Site>>) -> Response {
    let stream = received(follow(Arc::clone(&site.source)));
    Sse::new(stream).keep_alive(KeepAlive::default()).into_response()
}

async fn object(State(site): State<Arc<Site>>, Path(digest): Path<String>, headers: HeaderMap) -> Response {
    let Ok(digest) = digest.parse::<Digest>() else {
        return refusal(
            StatusCode::NOT_FOUND,
            "an object is named by the 64 hexadecimal digits of its digest",
        );
    };
    let read = move || {
        let none = || "the shown run names no such object, or the store has lost it".to_owned();
        let mut contents = site.contents().into_iter();
        let found = contents.find_map(|content| content.file(site.source.as_ref(), &digest));
        let found = found.or_else(|| made_now(site.source.as_ref(), &digest));
        found.ok_or_else(none)
    };
    let range = headers.get(header::RANGE).and_then(|range| range.to_str().ok());
    file(blocking(read).await, range)
}

async fn photo(
    State(site): State<Arc<Site>>,
    Path((run, field, digest)): Path<(u64, usize, String)>,
) -> Response {
    let Ok(digest) = digest.parse::<Digest>() else {
        return refusal(
            StatusCode::NOT_FOUND,
            "a photo is named by the 64 hexadecimal digits of its digest",
        );
    };
    let read = move || {
        let (content, field) = site.field(run, field)?;
        content.photo(site.source.as_ref(), &field, &digest)
    };
    file(blocking(read).await, None)
}

async fn scene(State(site): State<Arc<Site>>, Path((run, field)): Path<(u64, usize)>) -> Response {
    let read = move || {
        let (_, field) = site.field(run, field)?;
        serde_json::to_string(&field.view()).map_err(|error| error.to_string())
    };
    match blocking(read).await {
        Ok(json) => answer(JSON, json),
        Err(message) => refusal(StatusCode::NOT_FOUND, &message),
    }
}

/// Answers with the points of the calibration, as splats.
async fn points(State(site): State<Arc<Site>>, Path((run, field)): Path<(u64, usize)>) -> Response {
    match blocking(move || site.field(run, field)).await {
        Ok((_, field)) => answer(BYTES, pack(&splats_of_points(field.scene()))),
        Err(message) => refusal(StatusCode::NOT_FOUND, &message),
    }
}

/// Answers with the splats of a field, or how far they are.
async fn splats(State(site): State<Arc<Site>>, Path((run, field)): Path<(u64, usize)>) -> Response {
    let job = match blocking(move || site.splats(run, field)).await {
        Ok(job) => job,
        Err(message) => return refusal(StatusCode::NOT_FOUND, &message),
    };
    match job.state() {
        SplatState::Done(bytes) => answer(BYTES, Bytes::from_owner(bytes)),
        SplatState::Failed(message) => refusal(StatusCode::UNPROCESSABLE_ENTITY, &message),
        SplatState::Running(at) => (StatusCode::ACCEPTED, json(&at)).into_response(),
    }
}

/// Layer that a page requests.
#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Mode {
    Color,
    Depth,
    Uncertainty,
    Difference,
}

/// A view that a page requests.
#[derive(Deserialize)]
struct FramesRequest {
    run: u64,
    field: usize,
    /// A number that the page has drawn for itself.
    viewer: u64,
    mode: Mode,
    /// The photo that a difference is from.
    photo: Option<Digest>,
    #[serde(flatten)]
    view: View,
}

async fn frames(State(site): State<Arc<Site>>, body: Bytes) -> Response {
    let asked = asked(&site, &body, |request: &FramesRequest| {
        (request.run, request.field, [&request.view])
    })
    .await;
    let (request, field) = match asked {
        Ok(asked) => asked,
        Err(response) => return *response,
    };
    let shown = match shown(&site, &field, &request).await {
        Ok(shown) => shown,
        Err(message) => return refusal(StatusCode::UNPROCESSABLE_ENTITY, &message),
    };
    let mut frames = site.renderer.frames(request.viewer, field, request.view, shown);
    // The first picture decides the status: a failed render is answered as text.
    match frames.recv().await {
        Some(Ok(first)) => {
            let all = stream::iter([Ok(first)]).chain(received(frames));
            answer(BYTES, Body::from_stream(all))
        }
        Some(Err(error)) => refusal(StatusCode::UNPROCESSABLE_ENTITY, &error.to_string()),
        None => refusal(StatusCode::CONFLICT, "a newer view is wanted"),
    }
}

/// Returns what a picture has to show. For a difference it reads the photo.
async fn shown(site: &Arc<Site>, field: &SharedField, request: &FramesRequest) -> Result<Shown, String> {
    let photo = request
        .photo
        .ok_or("a difference needs a photo: the request names none");
    Ok(match request.mode {
        Mode::Color => Shown::Color,
        Mode::Depth => Shown::Depth,
        Mode::Uncertainty => Shown::Uncertainty,
        Mode::Difference => {
            let (site, field, photo) = (Arc::clone(site), Arc::clone(field), photo?);
            let read = move || {
                let frame = field.photo(&photo)?;
                Reference::read(site.source.as_ref(), frame, field.falloff(frame))
            };
            Shown::Difference(Arc::new(blocking(read).await?))
        }
    })
}

/// A point of a view that a page requests.
#[derive(Deserialize)]
struct PickRequest {
    run: u64,
    field: usize,
    #[serde(flatten)]
    mark: Mark,
}

/// A pixel of a view.
#[derive(Deserialize)]
struct Mark {
    /// Column and row.
    pixel: [u32; 2],
    #[serde(flatten)]
    view: View,
}

async fn picked(State(site): State<Arc<Site>>, body: Bytes) -> Response {
    let asked = asked(&site, &body, |request: &PickRequest| {
        (request.run, request.field, [&request.mark.view])
    })
    .await;
    let (request, field) = match asked {
        Ok(asked) => asked,
        Err(response) => return *response,
    };
    let work = move || pick(&field, &request.mark.view, request.mark.pixel);
    rendered(site.renderer.run(work).await)
}

/// Two points whose distance a page requests.
#[derive(Deserialize)]
struct DistanceRequest {
    run: u64,
    field: usize,
    marks: [Mark; 2],
}

async fn measured(State(site): State<Arc<Site>>, body: Bytes) -> Response {
    let asked = asked(&site, &body, |request: &DistanceRequest| {
        (
            request.run,
            request.field,
            request.marks.each_ref().map(|mark| &mark.view),
        )
    })
    .await;
    let (request, field) = match asked {
        Ok(asked) => asked,
        Err(response) => return *response,
    };
    let work = move || {
        let [a, b] = &request.marks;
        let [a, b] = [pick(&field, &a.view, a.pixel)?, pick(&field, &b.view, b.pixel)?];
        distance(&a, &b).ok_or_else(|| {
            FrameError::Failed(
                "the field has no surface at one of the points on which its retrainings agree".to_owned(),
            )
        })
    };
    rendered(site.renderer.run(work).await)
}

/// Answers with rendered values, or with an error if the server ends.
fn rendered<T: Serialize>(made: Option<Result<T, FrameError>>) -> Response {
    match made {
        Some(Ok(made)) => json(&made),
        Some(Err(error)) => refusal(StatusCode::UNPROCESSABLE_ENTITY, &error.to_string()),
        None => refusal(StatusCode::SERVICE_UNAVAILABLE, "the server ends"),
    }
}

/// Reads a request for views, checks these, and returns it with its field.
async fn asked<R: DeserializeOwned, const N: usize>(
    site: &Arc<Site>,
    body: &[u8],
    of: impl Fn(&R) -> (u64, usize, [&View; N]),
) -> Result<(R, SharedField), Box<Response>> {
    let refused = |status, message: String| Box::new(refusal(status, &message));
    let request: R = serde_json::from_slice(body)
        .map_err(|error| refused(StatusCode::BAD_REQUEST, format!("not a view: {error}")))?;
    let (run, field, views) = of(&request);
    for view in views {
        view.check()
            .map_err(|message| refused(StatusCode::BAD_REQUEST, message))?;
    }
    let site = Arc::clone(site);
    let found = blocking(move || site.field(run, field)).await;
    let (_, field) = found.map_err(|message| refused(StatusCode::NOT_FOUND, message))?;
    Ok((request, field))
}

/// Returns the first result that is good, else the first error.
fn first_good<T>(results: impl Iterator<Item = Result<T, String>>, none: &str) -> Result<T, String> {
    let mut first = None;
    for result in results {
        match result {
            Ok(good) => return Ok(good),
            Err(error) => first = first.or(Some(error)),
        }
    }
    Err(first.unwrap_or_else(|| none.to_owned()))
}

/// Runs what reads the store where it holds up nobody.
async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, String> + Send + 'static,
) -> Result<T, String> {
    let done = tokio::task::spawn_blocking(work).await;
    done.unwrap_or_else(|error| Err(format!("the request failed: {error}")))
}
