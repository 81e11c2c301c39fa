//! The process's allocator: it counts what goes to the heap, so that every session shows whether the path of a
//! sample is free of allocations, and it recycles the one small block that would otherwise go there with every
//! message.
//!
//! iceoryx2 0.10 makes a reference-counted box of 48 bytes for every loan and frees it when the message is
//! sent. [`Recycled`] keeps the last freed block of each small size for the next request of that size, so
//! after warm-up that box is always the same one and the heap is never asked.
//!
//! ONNX Runtime's own allocations, in C++, do not come by here.

use std::alloc::{GlobalAlloc, Layout, System};
use std::ptr::null_mut;
use std::sync::atomic::{AtomicPtr, AtomicU64, Ordering};

/// Sizes are told apart in steps of this many bytes, which is also the alignment of every recycled block.
const STEP: usize = 16;
/// Recycled sizes: up to 64 bytes.
const SIZES: usize = 4;

struct CountingAllocator {
    allocations: AtomicU64,
    recycled: [Recycled; SIZES],
}

#[global_allocator]
static ALLOCATOR: CountingAllocator =
    CountingAllocator { allocations: AtomicU64::new(0), recycled: [const { Recycled::empty() }; SIZES] };

/// How often this process has asked the heap for memory.
pub fn allocations() -> u64 {
    ALLOCATOR.allocations.load(Ordering::Relaxed)
}

/// A place for one freed block. Taking and putting are single atomic exchanges of the whole place, so a block
/// is only ever in one hand.
struct Recycled(AtomicPtr<u8>);

impl Recycled {
    const fn empty() -> Recycled {
        Recycled(AtomicPtr::new(null_mut()))
    }

    /// The block kept here, or null.
    fn take(&self) -> *mut u8 {
        self.0.swap(null_mut(), Ordering::Acquire)
    }

    /// Keeps `block`; `false` when there is one already.
    fn put(&self, block: *mut u8) -> bool {
        self.0.compare_exchange(null_mut(), block, Ordering::Release, Ordering::Relaxed).is_ok()
    }
}

/// What the heap is really asked for: small blocks are rounded up, so that all of a size are interchangeable.
/// Gives the place for freed ones of that size, too, if there is one.
fn rounded(layout: Layout) -> (Layout, Option<&'static Recycled>) {
    let steps = layout.size().div_ceil(STEP);
    if !(1..=SIZES).contains(&steps) || layout.align() > STEP {
        return (layout, None);
    }
    // SAFETY: the alignment is a power of two, and so small a size does not overflow when rounded up to it.
    let rounded = unsafe { Layout::from_size_align_unchecked(steps * STEP, STEP) };
    (rounded, Some(&ALLOCATOR.recycled[steps - 1]))
}

// SAFETY: a block comes either from the system's allocator or from a `Recycled`, which holds only blocks that
// the system's allocator gave for the same rounded layout and that have been freed since, each in one hand at
// a time. The layout given to the system's allocator depends on the caller's layout alone, so it is the same
// when a block is freed.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let (layout, recycled) = rounded(layout);
        let block = recycled.map_or(null_mut(), Recycled::take);
        if !block.is_null() {
            return block;
        }
        self.allocations.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the layout is the caller's, at most made larger.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        let (layout, recycled) = rounded(layout);
        if !recycled.is_some_and(|recycled| recycled.put(block)) {
            // SAFETY: the block was given for this very layout, see above, and nobody else holds it.
            unsafe { System.dealloc(block, layout) }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::hint::black_box;

    #[test]
    fn an_allocation_is_counted() {
        let before = allocations();
        let value = black_box(vec![7_u8; 4096]);
        assert!(allocations() > before);
        drop(value);
    }

    #[test]
    fn blocks_are_never_in_two_hands() {
        let workers: Vec<_> = (0..4_u64)
            .map(|worker| {
                std::thread::spawn(move || {
                    for round in 0..20_000 {
                        let mine = black_box(Box::new([worker, round, worker ^ round, 0, 0, 0]));
                        assert_eq!(*mine, [worker, round, worker ^ round, 0, 0, 0]);
                    }
                })
            })
            .collect();
        workers.into_iter().for_each(|worker| worker.join().unwrap());
    }

    #[test]
    fn every_size_and_alignment_is_served() {
        for size in 0..200 {
            let bytes = black_box(vec![0xA5_u8; size]);
            assert!(bytes.iter().all(|byte| *byte == 0xA5));
            let grown: Vec<u8> = bytes.into_iter().chain([1]).collect();
            assert_eq!(grown.len(), size + 1);
        }
        #[repr(align(64))]
        struct Aligned(u8);
        let aligned = black_box(Box::new(Aligned(3)));
        assert_eq!((&raw const *aligned as usize % 64, aligned.0), (0, 3));
    }
}
