use std::collections::BTreeMap;

use posed_core::pnp::Status;
use serde::Serialize;

use super::seen::Seen;

/// What statuses and reasons are worth: how often the answers behind them are right. Right is an ADD(-S) below a tenth of the
/// diameter.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Verdicts {
    pub ok: usize,
    /// Of these, wrong: what must not happen.
    pub ok_wrong: usize,
    /// Answers with another status.
    pub not_ok: usize,
    /// Of these, right: what was thrown away.
    pub not_ok_right: usize,
    /// Views without an answer.
    pub unanswered: usize,
    /// Every status that occurs.
    pub statuses: Vec<Counted>,
    /// Every reason that occurs; an answer may have several.
    pub reasons: Vec<Counted>,
}

/// How many answers have something, and how many of them are right.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Counted {
    pub name: String,
    pub answers: usize,
    pub right: usize,
}

impl Verdicts {
    /// Of the `ok` answers; `None` without any.
    #[must_use]
    pub fn ok_wrong_share(&self) -> Option<f64> {
        (self.ok > 0).then(|| self.ok_wrong as f64 / self.ok as f64)
    }

    pub(super) fn of(seen: &[Seen<'_>]) -> Self {
        let mut verdicts = Self::default();
        let (mut statuses, mut reasons) = (BTreeMap::<Status, Counted>::new(), BTreeMap::<String, Counted>::new());
        for one in seen {
            let Some(said) = &one.record.said else {
                verdicts.unanswered += 1;
                continue;
            };
            let right = one.view.is_right();
            let (all, other) = if said.answer.status == Status::Ok {
                (&mut verdicts.ok, (!right).then_some(&mut verdicts.ok_wrong))
            } else {
                (&mut verdicts.not_ok, right.then_some(&mut verdicts.not_ok_right))
            };
            *all += 1;
            if let Some(other) = other {
                *other += 1;
            }
            statuses.entry(said.answer.status).or_default().count(right);
            for reason in &said.answer.reasons {
                reasons.entry(reason.clone()).or_default().count(right);
            }
        }
        let named = |name: String, counted: Counted| Counted { name, ..counted };
        verdicts.statuses = statuses.into_iter().map(|(status, counted)| named(status.to_string(), counted)).collect();
        verdicts.reasons = reasons.into_iter().map(|(reason, counted)| named(reason, counted)).collect();
        verdicts
    }
}

impl Counted {
    fn count(&mut self, right: bool) {
        self.answers += 1;
        self.right += usize::from(right);
    }
}
