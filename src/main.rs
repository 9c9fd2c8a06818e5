//! The command line: argv to command to exit code.

fn main() {}
