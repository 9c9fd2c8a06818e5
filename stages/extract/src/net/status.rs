//! What an HTTP status means.

/// Parts of a request that decide the meaning of a status.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Asked {
    /// It asked for the rest of a body.
    pub rest: bool,
    /// It asked whether something is still the same.
    pub condition: bool,
}

/// What a status means for the request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum StatusClass {
    /// The body follows, from its start.
    Whole,
    /// The rest of the body follows.
    Rest,
    /// The file did not change.
    Unchanged,
    /// The file does not exist here.
    Absent,
    /// The rest cannot be sent: ask for the whole.
    Restart,
    /// A redirect.
    Elsewhere,
    /// The host refuses us.
    Forbidden,
    /// Another try may succeed.
    Again,
    /// No other try will succeed.
    Final,
}

/// Classifies a status.
///
/// 408, 425, 429, every 5xx, and answers that do not fit the request are worth another try. 403 and other 4xx are
/// final for this address.
pub(super) fn classify(status: u16, asked: Asked) -> StatusClass {
    match status {
        200 => StatusClass::Whole,
        206 if asked.rest => StatusClass::Rest,
        304 if asked.condition => StatusClass::Unchanged,
        301 | 302 | 303 | 307 | 308 => StatusClass::Elsewhere,
        404 | 410 => StatusClass::Absent,
        416 if asked.rest => StatusClass::Restart,
        403 => StatusClass::Forbidden,
        206 | 304 | 408 | 425 | 429 | 500..=599 => StatusClass::Again,
        _ => StatusClass::Final,
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
            (200, StatusClass::Whole, StatusClass::Whole),
            (204, StatusClass::Final, StatusClass::Final),
            (206, StatusClass::Again, StatusClass::Rest),
            (300, StatusClass::Final, StatusClass::Final),
            (302, StatusClass::Elsewhere, StatusClass::Elsewhere),
            (304, StatusClass::Again, StatusClass::Unchanged),
            (400, StatusClass::Final, StatusClass::Final),
            (401, StatusClass::Final, StatusClass::Final),
            (403, StatusClass::Forbidden, StatusClass::Forbidden),
            (404, StatusClass::Absent, StatusClass::Absent),
            (408, StatusClass::Again, StatusClass::Again),
            (410, StatusClass::Absent, StatusClass::Absent),
            (416, StatusClass::Final, StatusClass::Restart),
            (425, StatusClass::Again, StatusClass::Again),
            (429, StatusClass::Again, StatusClass::Again),
            (451, StatusClass::Final, StatusClass::Final),
            (500, StatusClass::Again, StatusClass::Again),
            (503, StatusClass::Again, StatusClass::Again),
            (599, StatusClass::Again, StatusClass::Again),
            (600, StatusClass::Final, StatusClass::Final),
        ] {
            assert_eq!(classify(status, plain), without, "{status}");
            assert_eq!(classify(status, both), with, "{status}, asked");
        }
    }
}
