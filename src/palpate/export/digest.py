"""SHA-256 (FIPS 180-4) of the file of an exported model, compiled, so that a library reads no other file."""

from __future__ import annotations

import math

import numpy as np

from palpate.compiled.jit import kernel_njit

DIGEST_FIRST, DIGEST_END, BLOCK_BYTES, WORD_BITS = 32, 64, 64, 0xFFFFFFFF
DIGEST_WORDS = 8
ROUND_COUNT = 64
FIRST_PRIMES = [p for p in range(2, 312) if all(p % d for d in range(2, math.isqrt(p) + 1))][:ROUND_COUNT]


def _cube_root(number: int) -> int:
    """Return the integer part of a cube root."""
    root = 1 << (-(-number.bit_length() // 3))
    while (better := (2 * root + number // root**2) // 3) < root:
        root = better
    return root


# the first 32 bits of the fractions of cube roots and of square roots of primes
ROUND_CONSTANTS = np.array([_cube_root(p << 96) & WORD_BITS for p in FIRST_PRIMES], dtype=np.int64)
INITIAL_STATE = np.array([math.isqrt(p << 64) & WORD_BITS for p in FIRST_PRIMES[:DIGEST_WORDS]], dtype=np.int64)


@kernel_njit(inner=True)
def _turn(word, count):
    return ((word >> count) | (word << (32 - count))) & WORD_BITS


@kernel_njit()
def check_file(content, length, words, state, expected):
    """Return 0 if the content of a file of a length [B] has the expected digest (8 words), else 1.

    SHA-256 (FIPS 180-4) of the content, with zeros in place of the digest in the header. `words` (64,) and `state` (8,)
    are scratch. The length is a multiple of 64.
    """
    for k in range(8):
        state[k] = INITIAL_STATE[k]
    blocks, bits = length // BLOCK_BYTES, 8 * length
    for block in range(blocks + 1):
        for k in range(16):
            word = 0
            for b in range(4):
                at = BLOCK_BYTES * block + 4 * k + b
                byte = 0
                if block < blocks and not DIGEST_FIRST <= at < DIGEST_END:
                    byte = int(content[at])
                word = (word << 8) | byte
            if block == blocks:  # the padding: a bit, zeros, and the length
                word = (1 << 31) if k == 0 else 0
                word = (bits >> 32) if k == 14 else bits & WORD_BITS if k == 15 else word
            words[k] = word
        for k in range(16, 64):
            a, b = words[k - 15], words[k - 2]
            first = _turn(a, 7) ^ _turn(a, 18) ^ (a >> 3)
            second = _turn(b, 17) ^ _turn(b, 19) ^ (b >> 10)
            words[k] = (words[k - 16] + first + words[k - 7] + second) & WORD_BITS
        a, b, c, d = state[0], state[1], state[2], state[3]
        e, f, g, h = state[4], state[5], state[6], state[7]
        for k in range(64):
            chosen = (e & f) ^ ((e ^ WORD_BITS) & g)
            one = h + (_turn(e, 6) ^ _turn(e, 11) ^ _turn(e, 25)) + chosen + ROUND_CONSTANTS[k] + words[k]
            other = (_turn(a, 2) ^ _turn(a, 13) ^ _turn(a, 22)) + ((a & b) ^ (a & c) ^ (b & c))
            h, g, f, e = g, f, e, (d + one) & WORD_BITS
            d, c, b, a = c, b, a, (one + other) & WORD_BITS
        state[0], state[1], state[2], state[3] = state[0] + a, state[1] + b, state[2] + c, state[3] + d
        state[4], state[5], state[6], state[7] = state[4] + e, state[5] + f, state[6] + g, state[7] + h
        for k in range(8):
            state[k] &= WORD_BITS
    different = 0
    for k in range(8):
        word = 0
        for b in range(4):
            word = (word << 8) | int(content[DIGEST_FIRST + 4 * k + b])
        different += state[k] != expected[k] or word != expected[k]
    return 0 if different == 0 else 1
