//! The server: one port, and the run that is shown on it.

use std::net::{IpAddr, SocketAddr, TcpListener};
use std::num::NonZero;
use std::sync::Arc;
use std::time::Duration;

use marf_field::Device;

use crate::ViewError;
use crate::access::Access;
use crate::connections::serve;
use crate::renderer::Renderer;
use crate::routes::routes;
use crate::site::Site;
use crate::source::Source;

/// Interval between two checks of the wish to stop.
const STOP_EVERY: Duration = Duration::from_millis(100);
/// Longest time for open requests after it.
const LAST_WORK: Duration = Duration::from_millis(500);

/// Options of the server.
#[derive(Debug, Clone)]
pub struct Options {
    /// Name or address to listen on.
    pub host: String,
    /// Port. 0 takes a free one.
    pub port: u16,
    /// Token that a request has to bring.
    pub token: Option<String>,
    /// Path prefix of all addresses, without a slash at its end. Empty for none.
    pub prefix: String,
    /// Threads that render. `None`: one a core.
    pub threads: Option<NonZero<usize>>,
    /// Device that renders.
    pub device: Device,
}

/// A server that has its port.
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
    options: Options,
    site: Arc<Site>,
}

impl Server {
    /// Takes the port, and reads the run to show.
    ///
    /// # Errors
    /// A port that is taken. An address that others can reach, without a token. A run that cannot be read.
    pub fn bind(options: Options, source: Arc<dyn Source>) -> Result<Self, ViewError> {
        check_prefix(&options.prefix)?;
        let access = Access::new(&options.host, options.token.as_deref())?;
        let listen = |cause| ViewError::Listen {
            host: options.host.clone(),
            port: options.port,
            cause,
        };
        let listener = TcpListener::bind((options.host.as_str(), options.port)).map_err(listen)?;
        let address = listener.local_addr().map_err(listen)?;
        listener.set_nonblocking(true).map_err(listen)?;
        let renderer = Renderer::new(options.threads)?;
        let site = Site::new(source, access, renderer, options.device.clone());
        site.refreshed().map_err(ViewError::Content)?;
        Ok(Self {
            listener,
            address,
            options,
            site: Arc::new(site),
        })
    }

    /// Returns the address to open, with the token.
    pub fn address(&self) -> String {
        let host = match self.options.host.parse::<IpAddr>() {
            Ok(IpAddr::V6(address)) => format!("[{address}]"),
            _ => self.options.host.clone(),
        };
        let token = self.options.token.as_ref().map(|token| format!("?token={token}"));
        let (port, prefix) = (self.address.port(), &self.options.prefix);
        format!("http://{host}:{port}{prefix}/{}", token.unwrap_or_default())
    }

    /// Answers requests until `stop` returns true.
    ///
    /// # Errors
    /// A port that is lost, threads that cannot be started.
    pub fn serve(self, stop: impl Fn() -> bool) -> Result<(), ViewError> {
        let mut runtime = tokio::runtime::Builder::new_multi_thread();
        let runtime = runtime
            .worker_threads(2)
            .enable_all()
            .build()
            .map_err(ViewError::Server)?;
        let routes = routes(self.site, &self.options.prefix);
        let served = runtime.block_on(async {
            let listener = tokio::net::TcpListener::from_std(self.listener)?;
            let stopped = async {
                while !stop() {
                    tokio::time::sleep(STOP_EVERY).await;
                }
            };
            tokio::select! {
                served = serve(listener, routes) => served,
                () = stopped => Ok(()),
            }
        });
        runtime.shutdown_timeout(LAST_WORK);
        served.map_err(ViewError::Server)
    }
}

/// Checks a path below which everything is.
fn check_prefix(prefix: &str) -> Result<(), ViewError> {
    let is_plain = |char: char| char.is_ascii_alphanumeric() || "-_./".contains(char);
    let is_path = prefix.starts_with('/') && !prefix.ends_with('/') && !prefix.contains("//");
    if prefix.is_empty() || (is_path && prefix.chars().all(is_plain)) {
        return Ok(());
    }
    Err(ViewError::Prefix(prefix.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_prefix_is_a_path_without_a_slash_at_its_end() {
        for prefix in ["", "/mars", "/a/b.c/d-e_f"] {
            assert!(check_prefix(prefix).is_ok(), "{prefix}");
        }
        for prefix in [
            "mars",
            "/",
            "/mars/",
            "//evil.example",
            "/{x}",
            "/a b",
            "/\"><script>",
        ] {
            assert!(check_prefix(prefix).is_err(), "{prefix}");
        }
    }
}
