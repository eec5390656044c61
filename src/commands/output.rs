//! What sub-commands print: `println!` panics once nobody reads, as in `posed check | head -1`.

use std::fmt::Arguments;
use std::io::{ErrorKind, Write as _, stdout};
use std::process::exit;

/// Prints text. Ends the program, quietly where the reader has left.
pub(super) fn print(text: Arguments<'_>) {
    let Err(error) = stdout().write_fmt(text) else { return };
    if error.kind() == ErrorKind::BrokenPipe {
        exit(0);
    }
    eprintln!("posed: cannot write to the standard output: {error}");
    exit(1)
}

/// [`print`] with the end of a line.
macro_rules! say {
    ($($part:tt)*) => {
        $crate::commands::output::print(format_args!("{}\n", format_args!($($part)*)))
    };
}

pub(super) use say;
