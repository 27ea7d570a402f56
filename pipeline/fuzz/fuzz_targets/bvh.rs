//! Any bytes as a BVH file, parsed and, where that succeeds, retargeted.
#![no_main]

use libfuzzer_sys::fuzz_target;
use pipeline::retarget;
use datasets_spec::Skeleton;
use pipeline::source::bvh::Bvh;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(bvh) = Bvh::parse(bytes) {
        let _clip = retarget::clip(&bvh, &Skeleton::smplx_neutral(), None);
    }
});
