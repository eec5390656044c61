//! Cores that idle workers leave to one that works: objects of one image are then looked at side by side.

use std::sync::atomic::{AtomicIsize, Ordering};

/// One core for each worker that shares it.
#[derive(Debug)]
pub(super) struct Cores {
    /// Below zero while a worker works whose own core is lent: it does not wait for it.
    idle: AtomicIsize,
}

/// Cores in use until this is dropped.
pub(super) struct InUse<'a> {
    cores: &'a Cores,
    pub count: usize,
}

impl Cores {
    pub(super) fn new(count: usize) -> Self {
        Self { idle: AtomicIsize::new(count.try_into().unwrap_or(isize::MAX)) }
    }

    /// A worker's own core, idle or not.
    pub(super) fn own(&self) -> InUse<'_> {
        self.idle.fetch_sub(1, Ordering::Relaxed);
        InUse { cores: self, count: 1 }
    }

    /// Idle ones, as many as there are up to `most`.
    pub(super) fn borrow(&self, most: usize) -> InUse<'_> {
        let most = most.try_into().unwrap_or(isize::MAX);
        let lent = |idle: isize| idle.clamp(0, most);
        let take = |idle| (lent(idle) > 0).then(|| idle - lent(idle));
        let before = self.idle.fetch_update(Ordering::Relaxed, Ordering::Relaxed, take);
        InUse { cores: self, count: before.map_or(0, lent).unsigned_abs() }
    }
}

impl Drop for InUse<'_> {
    fn drop(&mut self) {
        self.cores.idle.fetch_add(self.count.cast_signed(), Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_idle_core_is_lent_once_and_comes_back() {
        let cores = Cores::new(3);
        let own = cores.own();
        let lent = cores.borrow(1);
        assert_eq!(lent.count, 1);
        assert_eq!(cores.borrow(5).count, 1, "one of three is left");
        let second = cores.own();
        let third = cores.own();
        assert_eq!(cores.borrow(5).count, 0, "two work, and one core is lent twice");
        drop((second, third, lent));
        assert_eq!(cores.borrow(5).count, 2);
        drop(own);
        assert_eq!(cores.borrow(5).count, 3);
    }
}
