#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    marf_remote::fuzzing::pack(bytes);
});
