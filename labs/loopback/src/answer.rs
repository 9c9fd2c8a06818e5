//! What an orderly server answers.

use std::collections::BTreeMap;

use super::{Content, Reply, Request, Shared, State};

/// Head and body of an answer, ready to be sent or spoilt.
pub(super) struct Answer {
    pub(super) status: u16,
    pub(super) headers: Vec<(String, String)>,
    pub(super) body: Vec<u8>,
}

impl Answer {
    pub(super) fn new(status: u16, body: Vec<u8>) -> Self {
        Self {
            status,
            headers: Vec::new(),
            body,
        }
    }

    pub(super) fn header(mut self, name: &str, value: impl Into<String>) -> Self {
        self.headers.push((name.to_owned(), value.into()));
        self
    }

    pub(super) fn head(&self, length: Option<i64>) -> Vec<u8> {
        let mut head = format!("HTTP/1.1 {} Whatever\r\nServer: Apache\r\n", self.status);
        for (name, value) in &self.headers {
            head.push_str(&format!("{name}: {value}\r\n"));
        }
        match length {
            Some(length) => head.push_str(&format!("Content-Length: {length}\r\n\r\n")),
            None => head.push_str("Transfer-Encoding: chunked\r\n\r\n"),
        }
        head.into_bytes()
    }
}

impl Shared {
    /// What an orderly server answers.
    pub(super) fn normal(&self, request: &Request, reply: &Reply) -> Answer {
        if request.method != "GET" {
            return Answer::new(405, Vec::new());
        }
        let path = request.path();
        let state = self.state.lock();
        if let Some(content) = state.files.get(path) {
            return conditional(content, request, reply);
        }
        if let Some(feed) = state.feeds.get(path).cloned() {
            drop(state); // the function may ask this server
            return match feed(path, request.query()) {
                Some(bytes) => Answer::new(200, bytes),
                None => Answer::new(404, b"none".to_vec()),
            };
        }
        if let Some(page) = listing(&state, path) {
            return Answer::new(200, page.into_bytes()).header("Content-Type", "text/html;charset=UTF-8");
        }
        if listing(&state, &format!("{path}/")).is_some() {
            let to = format!("http://{}{path}/", self.address);
            return Answer::new(301, b"moved".to_vec()).header("Location", to);
        }
        Answer::new(404, b"<html>Not Found</html>".to_vec())
    }
}

/// 304, 206, 416 or 200.
fn conditional(content: &Content, request: &Request, reply: &Reply) -> Answer {
    let validated = |mut answer: Answer| {
        for (name, value) in [("ETag", &content.etag), ("Last-Modified", &content.modified)] {
            let header = value.clone().map(|value| (name.to_owned(), value));
            answer.headers.extend(header);
        }
        answer.header("Accept-Ranges", "bytes")
    };
    let is = |name: &str, value: &Option<String>| value.is_some() && request.header(name) == value.as_deref();
    let same = match request.header("if-none-match") {
        Some(_) => is("if-none-match", &content.etag),
        None => is("if-modified-since", &content.modified),
    };
    if same {
        return validated(Answer::new(304, Vec::new()));
    }
    let total = content.bytes.len() as i64;
    let from = request
        .header("range")
        .and_then(|range| range.strip_prefix("bytes=")?.strip_suffix('-')?.parse().ok());
    let fits = request.header("if-range").is_none()
        || is("if-range", &content.etag)
        || is("if-range", &content.modified);
    let stale = matches!(reply, Reply::StaleRest);
    let Some(from) = from.filter(|_: &i64| fits || stale) else {
        return validated(Answer::new(200, content.bytes.to_vec()));
    };
    if from >= total || matches!(reply, Reply::NoRest) {
        return Answer::new(416, Vec::new()).header("Content-Range", format!("bytes */{total}"));
    }
    let shift = match reply {
        Reply::ShiftedRest(shift) => *shift,
        _ => 0,
    };
    let start = (from + shift).clamp(0, total - 1);
    let span = format!("bytes {start}-{}/{total}", total - 1);
    let mut rest = content.bytes[start as usize..].to_vec();
    if let Reply::LyingRest(late) = reply {
        let length = rest.len();
        rest.rotate_left((*late).min(length));
    }
    let answer = Answer::new(206, rest).header("Content-Range", span);
    if stale {
        return answer.header("ETag", "\"another\"");
    }
    validated(answer)
}

/// An Apache page of a folder: the fancy table, sorted by name, long names cut in the visible text.
fn listing(state: &State, folder: &str) -> Option<String> {
    let parent = folder.strip_suffix('/')?;
    let known = state.files.keys().chain(&state.folders);
    let below: BTreeMap<String, Option<usize>> = known
        .filter_map(|path| {
            let rest = path.strip_prefix(folder).filter(|rest| !rest.is_empty())?;
            match rest.split_once('/') {
                Some((name, _)) => Some((format!("{name}/"), None)),
                None => Some((rest.to_owned(), Some(state.files.get(path)?.bytes.len()))),
            }
        })
        .collect();
    if below.is_empty() && !state.folders.contains(folder) {
        return None;
    }
    let up = parent.rfind('/').map_or("/", |end| &parent[..=end]);
    let mut page = format!(
        "<!DOCTYPE HTML PUBLIC \"-//W3C//DTD HTML 3.2 Final//EN\">\n<html>\n <head><title>Index of {parent}</title></head>\n \
         <body>\n<h1>Index of {parent}</h1>\n  <table>\n   <tr><th valign=\"top\"><img src=\"/icons/blank.gif\" alt=\"[ICO]\"></th>\
         <th><a href=\"?C=N;O=D\">Name</a></th><th><a href=\"?C=M;O=A\">Last modified</a></th>\
         <th><a href=\"?C=S;O=A\">Size</a></th><th><a href=\"?C=D;O=A\">Description</a></th></tr>\n   \
         <tr><th colspan=\"5\"><hr></th></tr>\n<tr><td valign=\"top\"><img src=\"/icons/back.gif\" alt=\"[PARENTDIR]\"></td>\
         <td><a href=\"{up}\">Parent Directory</a></td><td>&nbsp;</td><td align=\"right\">  - </td><td>&nbsp;</td></tr>\n"
    );
    for (name, bytes) in below {
        let shown = if name.len() > 30 {
            format!("{}..&gt;", &name[..27])
        } else {
            name.clone()
        };
        let size = bytes.map_or_else(|| "  - ".to_owned(), rounded);
        let date = date(state, &format!("{folder}{name}"));
        page.push_str(&format!(
            "<tr><td valign=\"top\"><a href=\"{name}\"><img src=\"/icons/image2.gif\" alt=\"[IMG]\"></a></td>\
             <td><a href=\"{name}\">{shown}</a></td><td align=\"right\">{date}  </td>\
             <td align=\"right\">{size}</td><td>&nbsp;</td></tr>\n"
        ));
    }
    page.push_str("   <tr><th colspan=\"5\"><hr></th></tr>\n</table>\n</body></html>\n");
    Some(page)
}

/// When a file was last changed, or a folder: with the newest file that is directly in it.
fn date(state: &State, path: &str) -> String {
    let below = state.files.range(path.to_owned()..);
    let below = below.take_while(|(other, _)| other.starts_with(path));
    let is_folder = path.ends_with('/');
    let is_in = |rest: &str| rest.is_empty() || (is_folder && !rest.contains('/'));
    let files = below.filter(|(other, _)| is_in(&other[path.len()..]));
    let dates = files.filter_map(|(_, file)| Some(listed(file.modified.as_deref()?)));
    dates.max().unwrap_or_else(|| listed(super::MODIFIED))
}

/// `Tue, 01 Mar 2022 10:20:00 GMT` as a listing writes it: `2022-03-01 10:20`.
fn listed(modified: &str) -> String {
    let months = [
        "Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec",
    ];
    let mut words = modified.split_whitespace().skip(1);
    let mut word = || words.next().unwrap_or_default();
    let (day, month, year, time) = (word(), word(), word(), word());
    let month = months
        .iter()
        .position(|name| *name == month)
        .map_or(0, |at| at + 1);
    format!("{year}-{month:02}-{day} {}", time.get(..5).unwrap_or_default())
}

/// As Apache rounds: `512`, `3.1K`, `64M`.
fn rounded(bytes: usize) -> String {
    let (mut value, mut unit) = (bytes as f64, "");
    for next in ["K", "M", "G"] {
        if value >= 1_000.0 {
            (value, unit) = (value / 1_024.0, next);
        }
    }
    if unit.is_empty() || value >= 9.95 {
        format!("{value:.0}{unit}")
    } else {
        format!("{value:.1}{unit}")
    }
}
