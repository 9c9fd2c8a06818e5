//! Errors as the command line prints them, and their exit codes.

use std::process::ExitCode;

use marf_run::{Answer, Diagnostic, Error};

use crate::terminal::escape_control;

/// Returns the exit code of an error: 1, 2, 8, 10, 11, 130, or that of an answer.
pub fn exit_code(error: &Error) -> ExitCode {
    ExitCode::from(match error {
        Error::Failed(_) => 1,
        Error::Usage(_) => 2,
        Error::Newer(_) => 8,
        Error::Elsewhere(_) => 10,
        Error::Locked(_) => 11,
        Error::Answered(answer, _) => answer_code(*answer),
        Error::Interrupted => 130,
    })
}

fn answer_code(answer: Answer) -> u8 {
    match answer {
        Answer::Whole => 0,
        Answer::NotOurs => 3,
        Answer::Altered => 4,
        Answer::Incomplete => 5,
        Answer::Changed => 6,
        Answer::Differs => 7,
        Answer::NotMade => 9,
        Answer::NoResult => 12,
        Answer::NotSigned => 13,
    }
}

/// Returns the text of an error for stderr.
pub fn text(error: &Error) -> String {
    error.diagnostic().map_or_else(
        || "stopped. Results so far are kept: run again to go on".to_owned(),
        diagnostic_text,
    )
}

/// Returns `error: …`, `cause: …`, `hint: …` on a line each, with control characters escaped, so that no
/// file name can drive the terminal.
fn diagnostic_text(diagnostic: &Diagnostic) -> String {
    let line = |label: &str, text: &Option<String>| {
        text.as_ref()
            .map(|text| format!("\n  {label}: {}", escape_control(text)))
            .unwrap_or_default()
    };
    format!(
        "error: {}{}{}",
        escape_control(&diagnostic.message),
        line("cause", &diagnostic.cause),
        line("hint", &diagnostic.hint)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_diagnostic_has_its_three_lines_and_no_escape_codes() {
        let diagnostic = Diagnostic {
            message: "bad\u{1b}[2J".into(),
            cause: Some("c".into()),
            hint: Some("h".into()),
        };
        assert_eq!(
            diagnostic_text(&diagnostic),
            "error: bad\\u{1b}[2J\n  cause: c\n  hint: h"
        );
    }

    #[test]
    fn every_answer_but_the_good_one_has_a_code_of_its_own() {
        let code = |error: &Error| format!("{:?}", exit_code(error));
        let answered = |answer| Error::Answered(answer, Diagnostic::new("x"));
        assert_eq!(
            code(&answered(Answer::Differs)),
            format!("{:?}", ExitCode::from(7))
        );
        assert_eq!(
            code(&answered(Answer::NotMade)),
            format!("{:?}", ExitCode::from(9))
        );
        assert_eq!(code(&Error::Interrupted), format!("{:?}", ExitCode::from(130)));
    }
}
