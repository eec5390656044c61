//! What sub-commands print: `println!` panics once nobody reads, as in `posed check | head -1`.

use std::fmt::Arguments;
use std::io::{ErrorKind, Write as _, stdout};
use std::process::exit;

/// Prints text. Where the reader has left, nothing is printed any more, and the work goes on; other errors end the program.
pub(super) fn print(text: Arguments<'_>) {
    let Err(error) = stdout().write_fmt(text) else { return };
    if error.kind() != ErrorKind::BrokenPipe {
        eprintln!("posed: cannot write to the standard output: {error}");
        exit(1)
    }
}

/// [`print`] with the end of a line.
macro_rules! say {
    ($($part:tt)*) => {
        $crate::commands::output::print(format_args!("{}\n", format_args!($($part)*)))
    };
}

pub(super) use say;
