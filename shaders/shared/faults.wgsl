// Returns whether a number ran away in this step: then nothing that is trained may change.
fn faulted() -> bool {
    return any((faults[0] | faults[1]) != vec4<u32>(0u));
}
