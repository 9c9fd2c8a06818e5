// Quanta of an entry from the words of its gradient. Needs of the head: Quanta, FEATURES, PACKED.
// Packed, a pair of words holds (q1 << 32) + q0: a negative q0 has borrowed 1 from the upper word.
fn quanta_of(words: Quanta) -> Quanta {
    var quanta = words;
    for (var f = 1u; f < FEATURES; f += 2u) {
        quanta[f] += select(0, 1, PACKED && words[f - 1u] < 0);
    }
    return quanta;
}
