//! WGSL kernels of marf and their uniforms.
