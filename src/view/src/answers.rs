//! Forms of answers: a file or a part of it, a document, a sentence.

use axum::body::{Body, Bytes};
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use marf_report::File;
use serde::Serialize;

use crate::content::BYTES;
use crate::range::{RangePart, wanted};

/// Type of a page.
pub const HTML: &str = "text/html; charset=utf-8";
/// Type of a document.
pub const JSON: &str = "application/json";
/// Type of a sentence.
const TEXT: &str = "text/plain; charset=utf-8";

/// Answers with a file, or the requested part of it.
pub fn file(found: Result<File, String>, range: Option<&str>) -> Response {
    let file = match found {
        Ok(file) => file,
        Err(message) => return refusal(StatusCode::NOT_FOUND, &message),
    };
    let whole = Bytes::from_owner(file.bytes);
    let length = whole.len();
    let with_range = |status, content: String, response: Response| {
        (status, [(header::CONTENT_RANGE, content)], response).into_response()
    };
    let mut response = match wanted(range, length) {
        RangePart::Whole => answer(file.media, Body::from(whole)),
        RangePart::Inside(part) => {
            let content = format!("bytes {}-{}/{length}", part.start, part.end - 1);
            let response = answer(file.media, Body::from(whole.slice(part)));
            with_range(StatusCode::PARTIAL_CONTENT, content, response)
        }
        RangePart::Outside => {
            let status = StatusCode::RANGE_NOT_SATISFIABLE;
            let response = refusal(status, &format!("the file has {length} bytes"));
            return with_range(status, format!("bytes */{length}"), response);
        }
    };
    // The bytes of a digest never change.
    let headers = response.headers_mut();
    headers.insert(header::ACCEPT_RANGES, HeaderValue::from_static("bytes"));
    headers.insert(
        header::CACHE_CONTROL,
        HeaderValue::from_static("private, max-age=31536000, immutable"),
    );
    if file.media == BYTES {
        headers.insert(
            header::CONTENT_DISPOSITION,
            HeaderValue::from_static("attachment"),
        );
    }
    response
}

/// Answers with a document.
pub fn json(value: &impl Serialize) -> Response {
    match serde_json::to_string(value) {
        Ok(json) => answer(JSON, json),
        Err(error) => refusal(StatusCode::INTERNAL_SERVER_ERROR, &error.to_string()),
    }
}

/// Answers with contents of a type. They are not kept.
pub fn answer(media: &'static str, body: impl Into<Body>) -> Response {
    let headers = [
        (header::CONTENT_TYPE, HeaderValue::from_static(media)),
        (header::CACHE_CONTROL, HeaderValue::from_static("no-store")),
    ];
    (headers, body.into()).into_response()
}

/// Answers with a sentence.
pub fn refusal(status: StatusCode, message: &str) -> Response {
    let message = format!("{}\n", message.trim_end());
    (
        status,
        [(header::CONTENT_TYPE, HeaderValue::from_static(TEXT))],
        message,
    )
        .into_response()
}

/// Leads to another address.
pub fn redirect(to: &str) -> Response {
    let mut response = StatusCode::SEE_OTHER.into_response();
    if let Ok(to) = HeaderValue::from_str(to) {
        response.headers_mut().insert(header::LOCATION, to);
    }
    response
}
