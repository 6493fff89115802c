"""A heap of velocity samples, the one with the least bound of its cost on top; of equal ones the first sampled.

Called by the local planners, which score samples in this order until no other can win.
"""

from applr_ros1.common.kernels import kernel


@kernel
def sift_down(heap, keys, count, i):
    """Restore the heap of sample numbers, least (key, number) on top, after the key of heap[i] grew."""
    sample = heap[i]
    while 2 * i + 1 < count:
        child = 2 * i + 1
        if child + 1 < count and _before(keys, heap[child + 1], heap[child]):
            child += 1
        if not _before(keys, heap[child], sample):
            break
        heap[i] = heap[child]
        i = child
    heap[i] = sample


@kernel
def _before(keys, a, b):
    return keys[a] < keys[b] or (keys[a] == keys[b] and a < b)
