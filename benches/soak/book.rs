//! What became of every request.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

/// What became of one request.
pub enum Outcome {
    /// As it should be.
    Answered,
    /// Turned away with a word that it may come again.
    Refused(String),
    /// No answer, or a wrong one, where there should be one.
    Lost(String),
    /// What came of a request that has no right to an answer.
    Came(String),
}

/// A client in the table: its group and what it does.
pub type Row = (&'static str, &'static str);

#[derive(Default)]
struct Pages {
    rows: BTreeMap<Row, BTreeMap<String, usize>>,
    lost: usize,
    /// The first of them, in words.
    losses: Vec<String>,
}

#[derive(Default)]
pub struct Book(Mutex<Pages>);

const MAX_LOSSES: usize = 20;

impl Book {
    pub fn note(&self, row: Row, outcome: Outcome) {
        let mut pages = self.pages();
        let words = match outcome {
            Outcome::Answered => "answered".to_owned(),
            Outcome::Refused(code) => format!("refused ({code})"),
            Outcome::Came(what) => what,
            Outcome::Lost(why) => {
                pages.lost += 1;
                if pages.losses.len() < MAX_LOSSES {
                    pages.losses.push(format!("{}, {}: {why}", row.0, row.1));
                }
                "**lost**".to_owned()
            }
        };
        *pages.rows.entry(row).or_default().entry(words).or_default() += 1;
    }

    pub fn lost(&self) -> (usize, Vec<String>) {
        let pages = self.pages();
        (pages.lost, pages.losses.clone())
    }

    pub fn rows(&self) -> BTreeMap<Row, BTreeMap<String, usize>> {
        self.pages().rows.clone()
    }

    fn pages(&self) -> std::sync::MutexGuard<'_, Pages> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
