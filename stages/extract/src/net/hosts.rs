//! The hosts that hold photos of Mars.
//!
//! Hosts move and firewalls close, so these are the first values of the configuration, never part of a key: what a
//! photo is tells its product id and its bytes, wherever they came from.

/// One place of an archive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Host {
    /// Base address; paths go below it.
    pub base: &'static str,
    /// What it holds.
    pub holds: &'static str,
}

/// The imaging node's holdings, current: `mars2020/BUNDLE/…` and `msl/…` lie below it.
pub(crate) const IMAGING: Host = Host {
    base: "https://planetarydata.jpl.nasa.gov/img/data",
    holds: "images and labels of Mars 2020 and MSL",
};

/// The same trees at their older address; may redirect to [`IMAGING`].
pub(crate) const IMAGING_OLD: Host = Host {
    base: "https://pds-imaging.jpl.nasa.gov/data",
    holds: "images and labels of Mars 2020 and MSL, older links",
};

/// The raw-image feeds of both missions.
pub(crate) const FEEDS: Host = Host {
    base: "https://mars.nasa.gov",
    holds: "lists of raw images, hours after their downlink",
};

/// Another host of pictures that feeds name.
pub(crate) const FEED_IMAGES: Host = Host {
    base: "https://mars.jpl.nasa.gov",
    holds: "pictures that the feeds name",
};

/// Mirrors of the imaging node, in order of preference.
pub(crate) const PDS_MIRRORS: [Host; 2] = [IMAGING, IMAGING_OLD];

/// What a feed's crawl may ask: the feed, and the places of its pictures.
pub(crate) const FEED_HOSTS: [Host; 2] = [FEEDS, FEED_IMAGES];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::net::Origin;

    #[test]
    fn every_base_is_an_origin_that_may_be_asked() {
        for host in PDS_MIRRORS.into_iter().chain(FEED_HOSTS) {
            let origin = Origin::parse(host.base).unwrap();
            assert!(
                origin.is_secure() && !host.base.ends_with('/') && !host.holds.is_empty(),
                "{}",
                host.base
            );
        }
    }
}
