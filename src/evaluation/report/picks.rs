use crate::evaluation::record::Record;

/// Pictures in each group.
const MOST: usize = 8;

/// Views of one object that are worth looking at.
#[derive(Clone, Debug)]
pub struct Picks<'a> {
    pub title: &'static str,
    pub records: Vec<&'a Record>,
}

/// Groups of views: best, median, worst, and those whose status misleads. Empty groups are left out.
#[must_use]
pub fn picks<'a>(records: &[&'a Record], is_right: impl Fn(&Record) -> bool) -> Vec<Picks<'a>> {
    let mut sorted: Vec<&Record> = records.iter().copied().filter(|record| add_m(record).is_finite()).collect();
    sorted.sort_by(|a, b| add_m(a).total_cmp(&add_m(b)));
    let middle = sorted.len() / 2;
    let about = middle.saturating_sub(MOST / 2)..(middle + MOST / 2).min(sorted.len());
    let misled = |ok: bool| -> Vec<&'a Record> {
        sorted.iter().copied().filter(|record| record.is_ok() == ok && is_right(record) != ok).collect()
    };
    let mut ok_but_wrong = misled(true);
    ok_but_wrong.reverse();
    let right_but_not_ok = misled(false);
    let unanswered = records.iter().copied().filter(|record| !add_m(record).is_finite()).collect();
    let groups = [
        ("ok, but wrong", ok_but_wrong),
        ("right, but not ok", right_but_not_ok),
        ("worst", sorted.iter().rev().copied().collect()),
        ("without a pose", unanswered),
        ("median", sorted[about].to_vec()),
        ("best", sorted.clone()),
    ];
    let group = |(title, mut records): (_, Vec<_>)| {
        records.truncate(MOST);
        Picks { title, records }
    };
    groups.into_iter().map(group).filter(|group| !group.records.is_empty()).collect()
}

/// Infinite where there is no pose.
fn add_m(record: &Record) -> f64 {
    record.deviation().map_or(f64::INFINITY, |deviation| deviation.add_m)
}
