use super::options::WorkArgs;

/// So many are told one by one.
const MAX_TOLD: usize = 20;

/// What cannot be scored, each in words that name the file.
#[derive(Debug, Default)]
pub(super) struct Problems {
    all: Vec<String>,
    /// Views that show nothing of an object: nothing is wrong with them.
    pub(super) invisible: usize,
}

impl Problems {
    pub(super) fn push(&mut self, problem: String) {
        self.all.push(problem);
    }

    pub(super) fn all(&self) -> &[String] {
        &self.all
    }

    /// Keeps what went wrong, and returns the rest.
    pub(super) fn taken_from<R>(&mut self, results: impl IntoIterator<Item = Result<R, String>>) -> Vec<R> {
        results.into_iter().filter_map(|result| result.map_err(|reason| self.push(reason)).ok()).collect()
    }

    /// An error that lists them, unless they are to be skipped.
    pub(super) fn settle(&self, work: &WorkArgs) -> Result<(), String> {
        match &self.all[..] {
            [] => Ok(()),
            _ if work.keep_going => Ok(()),
            [only] => Err(format!("{only} (use --keep-going to skip it)")),
            _ => Err(format!("{} problems (use --keep-going to skip them)\n{}", self.all.len(), self.told())),
        }
    }

    /// Says on stderr what was left out.
    pub(super) fn report(&self) {
        if !self.all.is_empty() {
            eprintln!("skipped because of {} problems\n{}", self.all.len(), self.told());
        }
        if self.invisible > 0 {
            eprintln!("skipped views in which the object is not visible: {}", self.invisible);
        }
    }

    fn told(&self) -> String {
        let mut lines: Vec<_> = self.all.iter().take(MAX_TOLD).map(|problem| format!("  {problem}")).collect();
        if self.all.len() > MAX_TOLD {
            lines.push(format!("  and {} more", self.all.len() - MAX_TOLD));
        }
        lines.join("\n")
    }
}
