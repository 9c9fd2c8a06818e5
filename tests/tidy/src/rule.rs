//! The rules, and one place in the code where a rule does not hold.

/// What is looked for in the code.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rule {
    /// Functions of more than 80 lines, from `fn` to `}`. The number is the lines.
    LongFunctions,
    /// Files of more than 450 lines, tests included. The number is the lines.
    LongFiles,
    /// Functions with more than five arguments besides `self`. The number is the arguments.
    Arguments,
    /// Parameters of functions whose pattern is a tuple. The number is the elements.
    TupleParameters,
    /// Parameters of functions whose type is a tuple of two or more elements. No bar. The number is the elements.
    TupleTypes,
    /// Matches with an arm `true` or `false`. The number is those arms.
    BooleanMatches,
    /// Functions and modules named `of`, `as_`, `again` or `on`.
    Names,
    /// Types named after a state.
    States,
    /// Uses between files that are in one circle of uses. The number is the files of the circle.
    Circles,
    /// clap, indicatif and output to the terminal outside the package marf.
    Terminal,
    /// Files that are read by other functions than those of `marf_cache::file`, which refuse what has no end.
    Reads,
}

impl Rule {
    /// Every rule, in the order of the table.
    pub const ALL: [Self; 11] = [
        Self::LongFunctions,
        Self::LongFiles,
        Self::Arguments,
        Self::TupleParameters,
        Self::TupleTypes,
        Self::BooleanMatches,
        Self::Names,
        Self::States,
        Self::Circles,
        Self::Terminal,
        Self::Reads,
    ];

    /// Returns the name of the rule on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::LongFunctions => "long-functions",
            Self::LongFiles => "long-files",
            Self::Arguments => "arguments",
            Self::TupleParameters => "tuple-parameters",
            Self::TupleTypes => "tuple-types",
            Self::BooleanMatches => "boolean-matches",
            Self::Names => "names",
            Self::States => "states",
            Self::Circles => "circles",
            Self::Terminal => "terminal",
            Self::Reads => "reads",
        }
    }

    /// Returns the rule of a name, or nothing if there is none.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|rule| rule.name() == name)
    }
}

/// One place where a rule does not hold.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// The rule.
    pub rule: Rule,
    /// Path from the root of the checkout, with slashes.
    pub file: String,
    /// Line, from 1.
    pub line: usize,
    /// What the rule counts at this place, 1 if it counts nothing.
    pub number: usize,
    /// What was found.
    pub text: String,
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}:{}: {} ({})", self.file, self.line, self.text, self.number)
    }
}
