// occupancy: takes the densities found at the probes over into their cells.
//
// Source    instant-ngp, arXiv 2201.05989, appendix on occupancy grids: decay and maximum.
// Twin      marf_field::occupancy::Occupancy::update, first loop, on exp(raw + shift), within 2e-7 relative.
// Threads   one per slot: workgroup 64, folded over x and y.
// Reads     `cells` [capacity], `raw` [capacity] raw density, `counts`[slot] probes, `faults` [FAULT_SLOTS].
// Writes    `density` [cells] of the probed cells, each once: no two slots have one cell. Nothing on a fault.
// Extremes  NaN and infinite raw densities leave the cell. A cell never probed takes the density found.
@group(0) @binding(0) var<uniform> filling: Filling;
@group(0) @binding(1) var<storage, read> faults: array<vec4<u32>, FAULT_SLOTS / 4u>;
@group(0) @binding(2) var<storage, read> cells: array<u32>;
@group(0) @binding(3) var<storage, read> raw: array<f32>;
@group(0) @binding(4) var<storage, read_write> density: array<f32>;
@group(0) @binding(5) var<storage, read> counts: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let slot = flat(id, groups);
    if slot >= min(counts[filling.slot], filling.capacity) || faulted() {
        return;
    }
    let found = raw[slot];
    let finite = (bitcast<u32>(found) & 0x7fffffffu) < 0x7f800000u;
    if !finite {
        return;
    }
    let cell = cells[slot];
    let now = exp_own(found + filling.shift);
    let last = density[cell];
    let before = select(0.0, last * filling.decay, last < filling.unknown);
    density[cell] = select(now, before, before > now);
}
