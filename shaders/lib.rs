//! WGSL kernels of marf and their uniforms. One kernel a file, each with its contract at the head.
//!
//! Invariant: every kernel parses and validates in naga, with no capability beyond core WebGPU. This version
//! trains on the CPU: no kernel is dispatched yet.

/// Multiresolution hash-grid lookup, forward pass.
pub const HASH_ENCODE: &str = include_str!("hash_encode.wgsl");

/// The uniform `Size` of [`HASH_ENCODE`].
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HashEncodeSize {
    /// Number of points.
    pub points: u32,
    /// Number of levels.
    pub levels: u32,
}

/// One element of `levels` of [`HASH_ENCODE`].
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HashEncodeLevel {
    /// Cells a side.
    pub resolution: u32,
    /// Entries of its table; a power of two where hashed.
    pub entries: u32,
    /// Its first entry in the table of all levels.
    pub first: u32,
    /// 1 where every corner has its own entry, 0 where corners are hashed.
    pub dense: u32,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn validated(name: &str, source: &str) -> naga::Module {
        let module = naga::front::wgsl::parse_str(source)
            .unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(source)));
        let mut validator = naga::valid::Validator::new(
            naga::valid::ValidationFlags::all(),
            naga::valid::Capabilities::empty(),
        );
        validator
            .validate(&module)
            .unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(source)));
        module
    }

    /// Bytes of a struct of the shader, as naga lays it out.
    fn span(module: &naga::Module, name: &str) -> usize {
        let found = module
            .types
            .iter()
            .find(|(_, ty)| ty.name.as_deref() == Some(name));
        match found.map(|(_, ty)| &ty.inner) {
            Some(naga::TypeInner::Struct { span, .. }) => *span as usize,
            other => panic!("{name}: {other:?}"),
        }
    }

    #[test]
    fn every_kernel_is_valid_core_webgpu_and_its_structs_are_laid_out_as_in_rust() {
        let module = validated("hash_encode", HASH_ENCODE);
        assert_eq!(span(&module, "Size"), size_of::<HashEncodeSize>());
        assert_eq!(span(&module, "Level"), size_of::<HashEncodeLevel>());
    }

    #[test]
    fn every_kernel_begins_with_its_contract() {
        for heading in [
            "// Source",
            "// Twin",
            "// Threads",
            "// Reads",
            "// Writes",
            "// Extremes",
        ] {
            assert!(HASH_ENCODE.contains(heading), "{heading}");
        }
    }

    #[test]
    fn no_kernel_adds_floats_atomically() {
        assert!(!HASH_ENCODE.contains("atomic"));
    }
}
