//! Who may ask: Host, Origin and token of a request.

use std::net::IpAddr;

use axum::http::{HeaderMap, HeaderName, Method, header};
use marf_cache::Digest;

/// Shortest token: 16 characters of a random text are beyond guessing.
const LEAST_TOKEN_CHARS: usize = 16;

/// Options that would leave the page open to others.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AccessError {
    /// An address that others reach, without a token.
    #[error("{0} is not a loopback address, so others can reach the page: it needs a token")]
    NoToken(String),
    /// A token that can be guessed, or that no cookie can hold.
    #[error("the token has {0} characters: it needs 16 or more, letters and digits alone")]
    BadToken(usize),
}

impl AccessError {
    /// Returns how to solve it.
    pub fn hint(&self) -> &'static str {
        "make one with `--token \"$(openssl rand -hex 16)\"`, or leave `--host` out and use `ssh -L`"
    }
}

/// Why a request is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// A name that is not that of this server: a foreign page may have pointed its own name here (DNS rebinding).
    Host,
    /// A request that changes or costs something, from another page or from none.
    Origin,
    /// No token, or a wrong one.
    Token,
}

impl Refusal {
    /// Returns the sentence that is sent.
    pub fn message(self) -> &'static str {
        match self {
            Self::Host => "refused: the Host header is neither a loopback name nor the host of this server\n",
            Self::Origin => "refused: the Origin header is not that of this page\n",
            Self::Token => "refused: open the address that `marf view` printed, with its token\n",
        }
    }
}

/// Checks requests.
#[derive(Debug, Clone)]
pub struct Access {
    host: String,
    token: Option<Digest>,
}

impl Access {
    /// Returns the checks of a server on `host`.
    ///
    /// # Errors
    /// A host that others can reach, without a token. A token that is too short or has other characters.
    pub fn new(host: &str, token: Option<&str>) -> Result<Self, AccessError> {
        if let Some(token) = token
            && (token.len() < LEAST_TOKEN_CHARS || !token.bytes().all(|byte| byte.is_ascii_alphanumeric()))
        {
            return Err(AccessError::BadToken(token.len()));
        }
        if token.is_none() && !is_loopback(host) {
            return Err(AccessError::NoToken(host.to_owned()));
        }
        Ok(Self {
            host: host.to_ascii_lowercase(),
            token: token.map(|token| Digest::from_content(token.as_bytes())),
        })
    }

    /// Checks the headers of a request.
    ///
    /// # Errors
    /// The first reason to refuse it.
    pub fn check(&self, method: &Method, headers: &HeaderMap) -> Result<(), Refusal> {
        let authority = text(headers, &header::HOST).ok_or(Refusal::Host)?;
        if !self.is_own(host_of(authority)) {
            return Err(Refusal::Host);
        }
        if method != Method::GET && method != Method::HEAD && !is_same_origin(headers, authority) {
            return Err(Refusal::Origin);
        }
        if is_of_foreign_page(headers) {
            return Err(Refusal::Origin);
        }
        let given = bearer(headers).or_else(|| self.cookie(headers));
        if self.token.is_none() || given.is_some_and(|token| self.is_token(token)) {
            return Ok(());
        }
        Err(Refusal::Token)
    }

    /// Checks the host alone: for the request that brings the token in its address.
    ///
    /// # Errors
    /// [`Refusal::Host`].
    pub fn check_host(&self, headers: &HeaderMap) -> Result<(), Refusal> {
        let authority = text(headers, &header::HOST).ok_or(Refusal::Host)?;
        self.is_own(host_of(authority)).then_some(()).ok_or(Refusal::Host)
    }

    /// Returns true if a text is the token. Digests are compared, so that the time does not reveal the token.
    pub fn is_token(&self, given: &str) -> bool {
        self.token == Some(Digest::from_content(given.as_bytes()))
    }

    /// Returns the name of the cookie with the token: servers on other ports of the host have other ones.
    pub fn cookie_name(&self) -> String {
        let digits = self.token.map(|token| token.short()).unwrap_or_default();
        format!("marf-view-{digits}")
    }

    fn cookie<'h>(&self, headers: &'h HeaderMap) -> Option<&'h str> {
        let name = self.cookie_name();
        let cookies = text(headers, &header::COOKIE)?.split(';');
        let mut pairs = cookies.filter_map(|pair| pair.trim().split_once('='));
        pairs.find(|(found, _)| *found == name).map(|(_, value)| value)
    }

    fn is_own(&self, name: &str) -> bool {
        let name = name.to_ascii_lowercase();
        let is_address = name.parse::<IpAddr>().is_ok();
        is_loopback(&name) || name == self.host || (is_address && is_unspecified(&self.host))
    }
}

/// Returns true if a name is this machine alone.
pub fn is_loopback(name: &str) -> bool {
    name.eq_ignore_ascii_case("localhost")
        || name.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

fn is_unspecified(name: &str) -> bool {
    name.parse::<IpAddr>()
        .is_ok_and(|address| address.is_unspecified())
}

/// Returns the name of `name`, `name:port` or `[v6]:port`.
fn host_of(authority: &str) -> &str {
    match authority.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or_default(),
        None => authority.rsplit_once(':').map_or(authority, |(name, _)| name),
    }
}

/// Returns true if a request comes from a page of this server. Browsers send the origin with every request
/// except plain reading.
fn is_same_origin(headers: &HeaderMap, authority: &str) -> bool {
    let origin = text(headers, &header::ORIGIN).unwrap_or_default();
    let stripped = origin
        .strip_prefix("http://")
        .or_else(|| origin.strip_prefix("https://"));
    stripped.is_some_and(|origin| origin.eq_ignore_ascii_case(authority))
}

/// Returns true if a foreign page has requested more than to show this one. Browsers say so in these headers,
/// which no page can set.
fn is_of_foreign_page(headers: &HeaderMap) -> bool {
    let fetch = |name: &'static str| text(headers, &HeaderName::from_static(name));
    let is_own = matches!(fetch("sec-fetch-site"), None | Some("same-origin" | "none"));
    !is_own && fetch("sec-fetch-mode") != Some("navigate")
}

fn bearer(headers: &HeaderMap) -> Option<&str> {
    text(headers, &header::AUTHORIZATION)?.strip_prefix("Bearer ")
}

/// Returns a header that is there once, as text.
fn text<'h>(headers: &'h HeaderMap, name: &HeaderName) -> Option<&'h str> {
    let mut values = headers.get_all(name).iter();
    let value = values.next()?.to_str().ok()?;
    values.next().is_none().then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOKEN: &str = "0123456789abcdef";

    fn headers(pairs: &[(&'static str, &'static str)]) -> HeaderMap {
        let mut headers = HeaderMap::new();
        for (name, value) in pairs {
            headers.append(*name, value.parse().unwrap());
        }
        headers
    }

    #[test]
    fn only_names_of_this_machine_or_the_given_one_are_answered() {
        let access = Access::new("127.0.0.1", None).unwrap();
        for (host, expected) in [
            ("127.0.0.1:8460", Ok(())),
            ("localhost:9000", Ok(())),
            ("LOCALHOST", Ok(())),
            ("[::1]:8460", Ok(())),
            ("evil.example", Err(Refusal::Host)),
            ("127.0.0.1.evil.example:8460", Err(Refusal::Host)),
            ("localhost.evil.example", Err(Refusal::Host)),
            ("10.0.0.7:8460", Err(Refusal::Host)),
            ("", Err(Refusal::Host)),
        ] {
            let found = access.check(&Method::GET, &headers(&[("host", host)]));
            assert_eq!(found, expected, "{host}");
        }
        assert_eq!(access.check(&Method::GET, &headers(&[])), Err(Refusal::Host));
        let twice = headers(&[("host", "localhost"), ("host", "evil.example")]);
        assert_eq!(access.check(&Method::GET, &twice), Err(Refusal::Host));
    }

    #[test]
    fn on_all_addresses_a_number_is_answered_and_a_name_is_not() {
        let access = Access::new("0.0.0.0", Some(TOKEN)).unwrap();
        let check = |host| {
            let bearer = ("authorization", "Bearer 0123456789abcdef");
            access.check(&Method::GET, &headers(&[("host", host), bearer]))
        };
        assert_eq!(check("10.0.0.7:8460"), Ok(()));
        assert_eq!(check("rover.example:8460"), Err(Refusal::Host));
    }

    #[test]
    fn what_is_no_plain_reading_comes_from_this_page_or_is_refused() {
        let access = Access::new("localhost", None).unwrap();
        for (origin, expected) in [
            (Some("http://localhost:8460"), Ok(())),
            (Some("https://localhost:8460"), Ok(())),
            (Some("http://localhost:8461"), Err(Refusal::Origin)),
            (Some("http://evil.example"), Err(Refusal::Origin)),
            (Some("null"), Err(Refusal::Origin)),
            (None, Err(Refusal::Origin)),
        ] {
            let mut pairs = vec![("host", "localhost:8460")];
            pairs.extend(origin.map(|origin| ("origin", origin)));
            assert_eq!(
                access.check(&Method::POST, &headers(&pairs)),
                expected,
                "{origin:?}"
            );
        }
    }

    #[test]
    fn a_foreign_page_may_lead_here_and_nothing_else() {
        let access = Access::new("localhost", None).unwrap();
        for (site, mode, expected) in [
            ("same-origin", "cors", Ok(())),
            ("none", "navigate", Ok(())),
            ("cross-site", "navigate", Ok(())),
            ("cross-site", "no-cors", Err(Refusal::Origin)),
            ("same-site", "cors", Err(Refusal::Origin)),
        ] {
            let pairs = [
                ("host", "localhost"),
                ("sec-fetch-site", site),
                ("sec-fetch-mode", mode),
            ];
            assert_eq!(
                access.check(&Method::GET, &headers(&pairs)),
                expected,
                "{site} {mode}"
            );
        }
    }

    #[test]
    fn a_token_is_asked_for_in_a_header_or_in_its_cookie() {
        let access = Access::new("10.0.0.7", Some(TOKEN)).unwrap();
        let host = ("host", "10.0.0.7:8460");
        let check = |pair| access.check(&Method::GET, &headers(&[host, pair]));
        assert_eq!(check(("authorization", "Bearer 0123456789abcdef")), Ok(()));
        assert_eq!(
            check(("authorization", "Bearer 0123456789abcdee")),
            Err(Refusal::Token)
        );
        assert_eq!(check(("cookie", "other=1")), Err(Refusal::Token));
        let cookie = format!("other=1; {}={TOKEN}", access.cookie_name());
        let mut with_cookie = headers(&[host]);
        with_cookie.append("cookie", cookie.parse().unwrap());
        assert_eq!(access.check(&Method::GET, &with_cookie), Ok(()));
    }

    #[test]
    fn an_open_address_without_a_good_token_is_no_server() {
        let message = |host, token| Access::new(host, token).unwrap_err().to_string();
        assert!(message("0.0.0.0", None).starts_with("0.0.0.0 is not a loopback address"));
        assert!(message("rover.example", None).contains("token"));
        assert!(message("127.0.0.1", Some("short")).contains("has 5"));
        assert!(message("127.0.0.1", Some("0123456789abcde; Path=/")).contains("16 or more"));
    }
}
