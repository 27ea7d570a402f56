//! Alignment, prefetch and transposition of small blocks.

/// Numbers aligned to a cache line, so that a vector as wide as a line never straddles two.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub(crate) struct Aligned<T>(pub(crate) T);

/// Prefetches the cache line of a number; past the end of the list it does nothing.
///
/// Hardware prefetch alone halves throughput on slow sequential reads.
#[inline(always)]
pub(crate) fn prefetch<T>(numbers: &[T], at: usize) {
    #[cfg(target_arch = "x86_64")]
    if let (Some(number), Some(sse)) = (numbers.get(at), pulp::core_arch::x86::Sse::try_new()) {
        use std::arch::x86_64::_MM_HINT_T0;
        sse._mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(number).cast());
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (numbers, at);
}

/// The transpose of a small matrix.
#[inline(always)]
pub(crate) fn transpose(rows: [[f32; 4]; 4]) -> [[f32; 4]; 4] {
    #[cfg(target_arch = "x86_64")]
    if let Some(sse) = pulp::core_arch::x86::Sse::try_new() {
        let [mut a, mut b, mut c, mut d] = rows.map(pulp::cast);
        sse._MM_TRANSPOSE4_PS(&mut a, &mut b, &mut c, &mut d);
        return [pulp::cast(a), pulp::cast(b), pulp::cast(c), pulp::cast(d)];
    }
    std::array::from_fn(|column| std::array::from_fn(|row| rows[row][column]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_a_transpose_are_columns() {
        let rows: [[f32; 4]; 4] =
            std::array::from_fn(|row| std::array::from_fn(|column| (4 * row + column) as f32));
        let columns = transpose(rows);
        for row in 0..4 {
            for column in 0..4 {
                assert_eq!(columns[column][row], rows[row][column]);
            }
        }
    }
}
