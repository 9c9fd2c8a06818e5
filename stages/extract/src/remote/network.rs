//! How a pipeline uses the network: the table `network` of an archive on a server.

use std::time::Duration;

use marf_stage::ParamError;
use schemars::JsonSchema;
use serde::Deserialize;

use crate::net::{ClientSettings, Origin};

/// How the network is used.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct Network {
    /// Simultaneous requests to one host, 1 to 4.
    #[schemars(range(min = 1, max = 4))]
    pub connections: usize,
    /// Least time between two requests to one host, ms.
    #[schemars(range(max = 600_000))]
    pub delay_ms: u64,
    /// How often a request is tried, 1 to 10.
    #[schemars(range(min = 1, max = 10))]
    pub tries: u32,
    /// Wait before the second try, ms. It doubles with each further try, up to a minute.
    #[schemars(range(min = 1, max = 60_000))]
    pub retry_ms: u64,
    /// Longest silence of a server, s.
    #[schemars(range(min = 1, max = 3_600))]
    pub stall_s: u64,
    /// Sols that are less than this many sols older than the newest are listed again, because products
    /// arrive late. Older sols are not listed again once marf.lock pins them completely.
    pub relist_sols: u32,
    /// Address for the server's administrators, sent in the User-Agent.
    pub contact: Option<String>,
}

impl Default for Network {
    fn default() -> Self {
        Self {
            connections: 2,
            delay_ms: 250,
            tries: 5,
            retry_ms: 1_000,
            stall_s: 30,
            relist_sols: 30,
            contact: None,
        }
    }
}

impl Network {
    /// Returns how a client behaves that may ask these addresses.
    ///
    /// # Errors
    /// A number out of range, a contact that is not plain ASCII, an address that cannot be asked.
    pub fn settings(&self, allowed: &[String]) -> Result<ClientSettings, ParamError> {
        let within = |key: &str, value: u64, least: u64, most: u64| {
            if (least..=most).contains(&value) {
                return Ok(());
            }
            let message = format!("{value} is not within {least} to {most}");
            Err(ParamError::new(format!("network.{key}"), message))
        };
        within("connections", self.connections as u64, 1, 4)?;
        within("tries", u64::from(self.tries), 1, 10)?;
        within("delay_ms", self.delay_ms, 0, 600_000)?;
        within("retry_ms", self.retry_ms, 1, 60_000)?;
        within("stall_s", self.stall_s, 1, 3_600)?;
        let contact = self.contact.as_deref();
        if contact.is_some_and(|contact| !contact.bytes().all(|byte| (b' '..=b'~').contains(&byte))) {
            return Err(ParamError::new("network.contact", "not plain ASCII"));
        }
        Ok(ClientSettings {
            per_host: self.connections,
            delay: Duration::from_millis(self.delay_ms),
            tries: self.tries,
            first_wait: Duration::from_millis(self.retry_ms),
            stall: Duration::from_secs(self.stall_s),
            ..ClientSettings::polite(origins(allowed)?, contact)
        })
    }
}

/// Returns the addresses that a pipeline gives, or the usual ones where it gives none.
pub(crate) fn bases(given: &[String], usual: &[&str]) -> Vec<String> {
    if given.is_empty() {
        usual.iter().map(|base| (*base).to_owned()).collect()
    } else {
        given.to_vec()
    }
}

/// Returns the origins of addresses.
///
/// # Errors
/// An address that cannot be asked.
pub(crate) fn origins(addresses: &[String]) -> Result<Vec<Origin>, ParamError> {
    let origin =
        |address: &String| Origin::parse(address).map_err(|error| ParamError::new("base", error.to_string()));
    addresses.iter().map(origin).collect()
}
