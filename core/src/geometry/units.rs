/// BOP files are in millimetres.
pub const METRES_PER_MILLIMETRE: f64 = 1e-3;
