//! What every fault is: an injector that is prepared, injected and judged, round after round.

use clap::ValueEnum;

use crate::output::AnyError;

/// Faults of `faults`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Fault {
    /// SIGKILL at random moments
    Kill,
    /// Ctrl-C at random moments
    Interrupt,
    /// SIGKILL while photos are fetched
    FetchKill,
    /// Ctrl-C while photos are fetched
    FetchInterrupt,
    /// A bit flipped, a cut, an emptying in every file of a store
    Damage,
    /// Files that may not grow beyond a limit
    Limit,
    /// A disk of 16 MB that runs full
    Full,
    /// A store that may not be written
    ReadOnly,
    /// Eight programs on one store
    Eight,
    /// Garbage collections during eight programs
    Collect,
    /// File times far off
    Clock,
}

impl Fault {
    /// Returns whether photos are fetched from a server.
    pub fn needs_server(self) -> bool {
        matches!(self, Self::FetchKill | Self::FetchInterrupt)
    }

    /// Returns the word of the command line.
    pub fn word(self) -> String {
        let value = self.to_possible_value();
        value.map_or_else(String::new, |value| value.get_name().to_owned())
    }
}

/// Does a fault, one round after the other.
pub trait Injector {
    /// Makes what the round needs.
    fn prepare(&mut self, _round: u32) -> Outcome {
        Ok(())
    }

    /// Does the fault once, including the immediate reaction of the program.
    fn inject(&mut self, round: u32) -> Outcome;

    /// Checks the stores after the round.
    fn judge(&mut self, round: u32) -> Outcome;

    /// Checks what all rounds have left.
    fn finish(&mut self) -> Outcome {
        Ok(())
    }

    /// Returns a description of the fault, in words.
    fn detail(&self) -> String;
}

/// How a step of a round ended.
pub type Outcome<T = ()> = Result<T, RoundError>;

/// Why a round did not end well.
#[derive(Debug)]
pub enum RoundError {
    /// The program did what it should not.
    Bad(String),
    /// The fault cannot be done here.
    Impossible(AnyError),
}

impl<E: std::error::Error + Send + Sync + 'static> From<E> for RoundError {
    fn from(error: E) -> Self {
        Self::Impossible(error.into())
    }
}

impl From<RoundError> for AnyError {
    fn from(error: RoundError) -> Self {
        match error {
            RoundError::Bad(what) => what.into(),
            RoundError::Impossible(error) => error,
        }
    }
}
