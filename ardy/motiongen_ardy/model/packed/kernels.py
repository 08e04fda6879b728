"""Triton kernels for a layer on a GPU: attention within short sequences, and the sum and norm between products.

Torch's own attention is made for long sequences and leaves most of a GPU idle on tens of vectors; its sums, casts and
norms each read and write all data again. Here every program handles one head of one sequence, or one vector, so a
sequence's result does not depend on the others.
"""

# No `from __future__ import annotations`: Triton reads the annotations as they are.
import triton
import triton.language as tl


@triton.jit(do_not_specialize=["first", "length", "first_read", "num_read", "first_taken"])  # type: ignore[untyped-decorator]
def attend(
    packed,
    taken,
    first,
    length,
    first_read,
    num_read,
    first_taken,
    scale,
    HEADS: tl.constexpr,
    WIDTH: tl.constexpr,
    KEYS: tl.constexpr,
    QUERIES: tl.constexpr,
):
    """softmax(q k^T scale) v of one head in one sequence; the grid is (sequences, heads).

    packed: (P, 3, HEADS, WIDTH), sequences of `length` vectors each, starting at vector `first`. taken: (R, HEADS,
    WIDTH), receives vectors `first_read` to `first_read + num_read` of each sequence, from `first_taken` on. KEYS,
    QUERIES: powers of two, at least 16 and at least length and num_read.
    """
    sequence, head = tl.program_id(0).to(tl.int64), tl.program_id(1)
    queries, keys, columns = tl.arange(0, QUERIES), tl.arange(0, KEYS), tl.arange(0, WIDTH)
    row: tl.constexpr = 3 * HEADS * WIDTH
    begin = first + sequence * length
    is_read, is_key = queries[:, None] < num_read, keys[:, None] < length
    of_head = head * WIDTH + columns[None, :]
    query = tl.load(packed + (begin + first_read + queries)[:, None] * row + of_head, mask=is_read, other=0.0)
    at = packed + (begin + keys)[:, None] * row + of_head
    key = tl.load(at + HEADS * WIDTH, mask=is_key, other=0.0)
    value = tl.load(at + 2 * HEADS * WIDTH, mask=is_key, other=0.0)
    scores = tl.dot(query, tl.trans(key)) * scale
    scores = tl.where(keys[None, :] < length, scores, float("-inf"))
    weights = tl.exp(scores - tl.max(scores, 1)[:, None])
    mixed = tl.dot(weights.to(value.dtype), value) / tl.sum(weights, 1)[:, None]
    to = taken + (first_taken + sequence * num_read + queries)[:, None] * (HEADS * WIDTH) + of_head
    tl.store(to, mixed.to(taken.dtype.element_ty), mask=is_read)


@triton.jit  # type: ignore[untyped-decorator]
def add_and_norm(
    product,
    stream,
    weight,
    bias,
    added,
    normed,
    eps,
    WIDTH: tl.constexpr,
    BLOCK: tl.constexpr,
    NORM_ADDED: tl.constexpr,
):
    """One vector: stream + product, and the layer norm of that; the grid is (vectors).

    product: in any precision; stream: float32. added: float32, the sum, or its norm with NORM_ADDED; normed: the norm
    in its own precision. weight, bias: (WIDTH) of the norm. BLOCK: a power of two, at least WIDTH.
    """
    vector = tl.program_id(0).to(tl.int64)
    columns = tl.arange(0, BLOCK)
    inside = columns < WIDTH
    at = vector * WIDTH + columns
    total = tl.load(stream + at, mask=inside, other=0.0) + tl.load(product + at, mask=inside, other=0.0).to(tl.float32)
    apart = tl.where(inside, total - tl.sum(total, 0) / WIDTH, 0.0)
    scaled = apart * tl.rsqrt(tl.sum(apart * apart, 0) / WIDTH + eps)
    norm = scaled * tl.load(weight + columns, mask=inside) + tl.load(bias + columns, mask=inside)
    tl.store(added + at, norm if NORM_ADDED else total, mask=inside)
    tl.store(normed + at, norm.to(normed.dtype.element_ty), mask=inside)
