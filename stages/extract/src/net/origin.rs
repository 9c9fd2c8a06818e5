//! Where requests may go.

use std::fmt;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

use super::Url;

/// Redirects followed for one request.
pub(super) const MAX_HOPS: usize = 5;
/// Longest piece of a server's text that is shown, characters.
const SHOWN: usize = 120;

/// Scheme, host and port.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Origin {
    secure: bool,
    host: String,
    port: u16,
}

/// An address that cannot be the base of an archive.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` cannot be asked: {reason}")]
pub(crate) struct OriginError {
    /// The address, cut.
    pub text: String,
    /// Why.
    pub reason: &'static str,
}

/// A redirect that is not followed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("redirect from {from} to {to} refused: {reason}")]
pub(crate) struct Refused {
    /// The address that redirects.
    pub from: String,
    /// Where to.
    pub to: String,
    /// Why not.
    pub reason: &'static str,
}

impl Origin {
    /// Reads the origin of an address that the configuration names. Its path is ignored.
    ///
    /// # Errors
    /// No https (http is taken for a loopback host alone), a user name, no host.
    pub(crate) fn parse(text: &str) -> Result<Self, OriginError> {
        let error = |reason| OriginError {
            text: cut(text),
            reason,
        };
        let url = Url::parse(text).map_err(|_| error("it is not an address"))?;
        if has_user(&url) {
            return Err(error("it holds a user name or password"));
        }
        let origin = Self::from_url(&url).ok_or_else(|| error("it is neither https nor http with a host"))?;
        if !origin.secure && !origin.is_loopback() {
            return Err(error("http is taken for a loopback host alone: use https"));
        }
        Ok(origin)
    }

    /// Returns the origin of an address, if it is http or https and has a host.
    pub(crate) fn from_url(url: &Url) -> Option<Self> {
        let secure = match url.scheme() {
            "https" => true,
            "http" => false,
            _ => return None,
        };
        let host = url.host_str().filter(|host| !host.is_empty())?;
        Some(Self {
            secure,
            host: host.trim_end_matches('.').to_ascii_lowercase(),
            port: url.port_or_known_default()?,
        })
    }

    /// Whether it is reached over TLS.
    pub(crate) fn is_secure(&self) -> bool {
        self.secure
    }

    /// Returns host and port, by which requests are limited.
    pub(crate) fn authority(&self) -> String {
        format!("{}:{}", self.host, self.port)
    }

    fn address(&self) -> Option<IpAddr> {
        self.host
            .trim_start_matches('[')
            .trim_end_matches(']')
            .parse()
            .ok()
    }

    fn is_loopback(&self) -> bool {
        match self.address() {
            Some(address) => address.is_loopback(),
            None => self.host == "localhost",
        }
    }

    /// Whether it names a machine or a network that the public internet does not reach.
    fn is_private(&self) -> bool {
        match self.address() {
            Some(IpAddr::V4(address)) => private_v4(address),
            Some(IpAddr::V6(address)) => private_v6(address),
            None => {
                let suffixes = [".localhost", ".local", ".internal", ".lan", ".home.arpa"];
                !self.host.contains('.') || suffixes.iter().any(|suffix| self.host.ends_with(suffix))
            }
        }
    }
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scheme = if self.secure { "https" } else { "http" };
        write!(f, "{scheme}://{}:{}", self.host, self.port)
    }
}

/// Whether an address is in a range of RFC 6890 that is not globally reachable, or multicast.
fn private_v4(address: Ipv4Addr) -> bool {
    let [a, b, c, _] = address.octets();
    address.is_private()
        || address.is_loopback()
        || address.is_link_local()
        || address.is_multicast()
        || address.is_documentation()
        || a == 0
        || a >= 240
        || (a == 100 && (64..128).contains(&b))
        || (a == 192 && b == 0 && c == 0)
        || (a == 198 && (b == 18 || b == 19))
}

/// As [`private_v4`]. Addresses that wrap one of version 4 are judged by it.
fn private_v6(address: Ipv6Addr) -> bool {
    let segments = address.segments();
    if let Some(inner) = address.to_ipv4() {
        return private_v4(inner);
    }
    // 64:ff9b::/96 and 2002::/16 carry one too.
    let wrapped = |high: u16, low: u16| {
        let ([a, b], [c, d]) = (high.to_be_bytes(), low.to_be_bytes());
        private_v4(Ipv4Addr::new(a, b, c, d))
    };
    match segments {
        [0x64, 0xff9b, 0, 0, 0, 0, high, low] | [0x2002, high, low, ..] => wrapped(high, low),
        [first, ..] => first & 0xfe00 == 0xfc00 || first & 0xffc0 == 0xfe80 || first & 0xff00 == 0xff00,
    }
}

/// Whether the first request may go there.
pub(super) fn may_ask(allowed: &[Origin], url: &Url) -> bool {
    !has_user(url) && Origin::from_url(url).is_some_and(|origin| allowed.contains(&origin))
}

/// Returns where a redirect leads, if it may be followed.
///
/// A private or loopback address is followed only from such an address, even where the configuration names it.
///
/// # Errors
/// Names both ends of the redirect. Refused are: a text that is not an address, another scheme, https to http, a user
/// name, a private address, an origin that is not allowed.
pub(super) fn redirected(allowed: &[Origin], from: &Url, location: &str) -> Result<Url, Refused> {
    let refused = |to: String, reason| Refused {
        from: shown(from),
        to,
        reason,
    };
    let mut to = from
        .join(location)
        .map_err(|_| refused(cut(location), "it is not an address"))?;
    let name = shown(&to);
    let origin = Origin::from_url(&to)
        .ok_or_else(|| refused(name.clone(), "it is neither https nor http with a host"))?;
    let start = Origin::from_url(from);
    if !origin.secure && start.as_ref().is_none_or(|start| start.secure) {
        return Err(refused(name, "from https to http"));
    }
    if has_user(&to) {
        return Err(refused(name, "it holds a user name or password"));
    }
    if origin.is_private() && !start.is_some_and(|start| start.is_private()) {
        return Err(refused(name, "a private address"));
    }
    if !allowed.contains(&origin) {
        return Err(refused(name, "its origin is not among the archive's"));
    }
    to.set_fragment(None);
    Ok(to)
}

fn has_user(url: &Url) -> bool {
    !url.username().is_empty() || url.password().is_some()
}

/// Returns scheme, host and path of an address for display, without user and query.
pub(super) fn shown(url: &Url) -> String {
    match url.host_str() {
        Some(host) => {
            let port = url.port().map_or_else(String::new, |port| format!(":{port}"));
            cut(&format!("{}://{host}{port}{}", url.scheme(), url.path()))
        }
        None => cut(&format!("{}:…", url.scheme())),
    }
}

/// Cuts a server's text and makes its control characters visible.
pub(super) fn cut(text: &str) -> String {
    let mut kept: String = text.chars().take(SHOWN).flat_map(char::escape_debug).collect();
    if text.chars().nth(SHOWN).is_some() {
        kept.push('…');
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    fn url(text: &str) -> Url {
        Url::parse(text).unwrap()
    }

    fn allowed() -> Vec<Origin> {
        [
            "https://a.example",
            "https://b.example:8443",
            "http://127.0.0.1:8080",
            "http://[::1]:8080",
        ]
        .map(|text| Origin::parse(text).unwrap())
        .to_vec()
    }

    #[test]
    fn origins_are_https_or_named_loopback() {
        for good in [
            "https://A.example/img/data",
            "https://a.example:443",
            "https://a.example./x",
        ] {
            assert_eq!(Origin::parse(good).unwrap(), allowed()[0], "{good}");
        }
        for good in [
            "http://localhost:1",
            "http://127.9.9.9",
            "http://[::1]/",
            "https://10.0.0.5",
        ] {
            assert!(Origin::parse(good).is_ok(), "{good}");
        }
        for bad in [
            "http://a.example",
            "http://10.0.0.5",
            "ftp://a.example",
            "file:///etc/passwd",
            "https://me@a.example",
            "https://me:pw@a.example",
            "a.example",
            "",
            "https://",
            "http://0.0.0.0",
        ] {
            assert!(Origin::parse(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn redirects_inside_the_list_are_followed() {
        let from = url("https://a.example/one/two");
        for (location, to) in [
            ("three", "https://a.example/one/three"),
            ("/x#part", "https://a.example/x"),
            ("//b.example:8443/y", "https://b.example:8443/y"),
            ("https://b.example:8443/z?q=1", "https://b.example:8443/z?q=1"),
        ] {
            assert_eq!(
                redirected(&allowed(), &from, location).unwrap().as_str(),
                to,
                "{location}"
            );
        }
        let loopback = url("http://127.0.0.1:8080/a");
        assert!(redirected(&allowed(), &loopback, "http://[::1]:8080/b").is_ok());
    }

    #[test]
    fn hostile_redirects_are_refused_with_both_ends() {
        let from = url("https://a.example/one?key=secret");
        for (location, reason) in [
            ("http://a.example/one", "https to http"),
            ("http://127.0.0.1:8080/", "https to http"),
            ("https://127.0.0.1/", "private"),
            ("https://2130706433/", "private"),
            ("https://0x7f.1/", "private"),
            ("https://10.1.2.3/", "private"),
            ("https://172.16.0.1/", "private"),
            ("https://192.168.1.1/", "private"),
            ("https://169.254.169.254/latest", "private"),
            ("https://100.64.0.1/", "private"),
            ("https://0.0.0.0/", "private"),
            ("https://[::1]/", "private"),
            ("https://[::ffff:10.0.0.1]/", "private"),
            ("https://[64:ff9b::a00:1]/", "private"),
            ("https://[fd00::1]/", "private"),
            ("https://[fe80::1]/", "private"),
            ("https://localhost/", "private"),
            ("https://printer/", "private"),
            ("https://db.internal/", "private"),
            ("https://evil.example/", "origin"),
            ("https://a.example.evil.example/", "origin"),
            ("https://a.example:444/", "origin"),
            ("https://b.example/", "origin"),
            ("https://me@a.example/", "user"),
            ("https://a.example:x/", "not an address"),
            ("file:///etc/passwd", "neither"),
            ("data:text/html,x", "neither"),
            ("javascript:alert(1)", "neither"),
            ("ftp://a.example/", "neither"),
        ] {
            let error = redirected(&allowed(), &from, location).unwrap_err();
            assert!(
                error.reason.contains(reason),
                "{location}: {error}, expected {reason}"
            );
            let text = error.to_string();
            assert!(
                text.contains("https://a.example/one") && !text.contains("secret"),
                "{text}"
            );
        }
    }

    #[test]
    fn shown_texts_are_short_and_harmless() {
        assert_eq!(
            shown(&url("https://me:pw@a.example:444/p?q#f")),
            "https://a.example:444/p"
        );
        let long = cut(&format!("\u{1b}[2J{}", "x".repeat(1_000)));
        assert!(long.chars().count() < 140 && !long.contains('\u{1b}'), "{long}");
    }
}
