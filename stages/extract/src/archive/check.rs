//! What an archive on a server was asked for, and how the answer compares with what the readers expect.

use serde::Serialize;

/// One thing that an archive was asked for.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Check {
    /// What was asked for, in words.
    pub what: String,
    /// The address that answered, or that was asked first. Absent if nothing was asked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub url: Option<String>,
    /// How it compares with what the readers expect.
    pub state: CheckState,
    /// What was found, what differs, or why it was not checked.
    pub found: String,
}

/// How an answer compares with what the readers expect.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum CheckState {
    /// The readers read all that they need.
    AsExpected,
    /// It is missing, or something in it is not as the readers expect.
    Differs,
    /// The server gave no answer, or nothing named what to ask for.
    NotChecked,
}
