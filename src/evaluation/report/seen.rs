use crate::evaluation::metrics::ScoredView;
use crate::evaluation::record::Record;

/// One view, as the statistics take it.
#[derive(Clone, Copy)]
pub(super) struct Seen<'a> {
    pub(super) record: &'a Record,
    pub(super) view: ScoredView,
}

/// Views of one image together.
pub(super) fn by_image<'a>(seen: &[Seen<'a>]) -> Vec<Vec<Seen<'a>>> {
    let same = |a: &Seen<'_>, b: &Seen<'_>| {
        (&a.record.place.scene, a.record.place.image_id) == (&b.record.place.scene, b.record.place.image_id)
    };
    let mut sorted = seen.to_vec();
    sorted.sort_by(|a, b| a.record.place.cmp(&b.record.place));
    sorted.chunk_by(same).map(<[_]>::to_vec).collect()
}
