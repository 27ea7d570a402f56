//! Any bytes as a pickle, as a joblib dump, and as a motion of the STANCE release.
#![no_main]

use datasets_spec::Skeleton;
use libfuzzer_sys::fuzz_target;
use pickle::joblib;
use pipeline::source::stance;

fuzz_target!(|bytes: &[u8]| {
    let _value = pickle::read(bytes);
    let _dump = joblib::read(bytes);
    let _motion = stance::read_pickle_motion(bytes, &Skeleton::smplx_neutral());
});
