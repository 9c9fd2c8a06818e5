//! What to do with a status.

/// What a request asked beyond "give it to me".
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Asked {
    /// It asked for the rest of a body.
    pub rest: bool,
    /// It asked whether something is still the same.
    pub condition: bool,
}

/// What a status means for the request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Meaning {
    /// The body follows, from its beginning.
    Whole,
    /// The rest of the body follows.
    Rest,
    /// It is still the same.
    Unchanged,
    /// There is no such thing here.
    Absent,
    /// The rest cannot be had: ask for the whole.
    Restart,
    /// It is elsewhere.
    Elsewhere,
    /// The host does not want us.
    Forbidden,
    /// It may go better later.
    Again,
    /// It will not go better.
    Final,
}

/// Judges a status.
///
/// 408, 425, 429, every 5xx, and answers to questions that were not asked are worth another try; 403 and other 4xx
/// are final for this address.
pub(super) fn judge(status: u16, asked: Asked) -> Meaning {
    match status {
        200 => Meaning::Whole,
        206 if asked.rest => Meaning::Rest,
        304 if asked.condition => Meaning::Unchanged,
        301 | 302 | 303 | 307 | 308 => Meaning::Elsewhere,
        404 | 410 => Meaning::Absent,
        416 if asked.rest => Meaning::Restart,
        403 => Meaning::Forbidden,
        206 | 304 | 408 | 425 | 429 | 500..=599 => Meaning::Again,
        _ => Meaning::Final,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_status_has_one_meaning() {
        let plain = Asked {
            rest: false,
            condition: false,
        };
        let both = Asked {
            rest: true,
            condition: true,
        };
        for (status, without, with) in [
            (200, Meaning::Whole, Meaning::Whole),
            (204, Meaning::Final, Meaning::Final),
            (206, Meaning::Again, Meaning::Rest),
            (300, Meaning::Final, Meaning::Final),
            (302, Meaning::Elsewhere, Meaning::Elsewhere),
            (304, Meaning::Again, Meaning::Unchanged),
            (400, Meaning::Final, Meaning::Final),
            (401, Meaning::Final, Meaning::Final),
            (403, Meaning::Forbidden, Meaning::Forbidden),
            (404, Meaning::Absent, Meaning::Absent),
            (408, Meaning::Again, Meaning::Again),
            (410, Meaning::Absent, Meaning::Absent),
            (416, Meaning::Final, Meaning::Restart),
            (425, Meaning::Again, Meaning::Again),
            (429, Meaning::Again, Meaning::Again),
            (451, Meaning::Final, Meaning::Final),
            (500, Meaning::Again, Meaning::Again),
            (503, Meaning::Again, Meaning::Again),
            (599, Meaning::Again, Meaning::Again),
            (600, Meaning::Final, Meaning::Final),
        ] {
            assert_eq!(judge(status, plain), without, "{status}");
            assert_eq!(judge(status, both), with, "{status}, asked");
        }
    }
}
