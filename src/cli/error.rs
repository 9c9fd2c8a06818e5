//! Errors as the command line prints them, and their exit codes.

use std::process::ExitCode;

use marf_run::{Answer, Diagnostic, Error};

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

/// Returns the lines of an error for stderr.
pub fn lines(error: &Error) -> Vec<String> {
    error.diagnostic().map_or_else(
        || {
            vec![
                "stopped. Finished nodes and checkpoints are kept: run the same command again to continue"
                    .to_owned(),
            ]
        },
        diagnostic_lines,
    )
}

/// Returns `error: …`, `cause: …`, `hint: …` on a line each.
fn diagnostic_lines(diagnostic: &Diagnostic) -> Vec<String> {
    let line = |label: &str, text: &Option<String>| text.as_ref().map(|text| format!("  {label}: {text}"));
    [format!("error: {}", diagnostic.message)]
        .into_iter()
        .chain(line("cause", &diagnostic.cause))
        .chain(line("hint", &diagnostic.hint))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_diagnostic_has_three_lines() {
        let diagnostic = Diagnostic {
            message: "bad".into(),
            cause: Some("c".into()),
            hint: Some("h".into()),
        };
        let expected = ["error: bad", "  cause: c", "  hint: h"];
        assert_eq!(diagnostic_lines(&diagnostic), expected);
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
