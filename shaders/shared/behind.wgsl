// Colour of the background by direction, as marf_field::weights. Goes after math, colour and sh. The kernel
// declares `background` [3][16].
fn logits_behind(at: array<f32, 16>) -> vec3<f32> {
    var harmonics = at;
    var sum = vec3<f32>(0.0);
    for (var index = 0u; index < 16u; index++) {
        let row = vec3<f32>(background[index], background[16u + index], background[32u + index]);
        sum = fma(row, vec3<f32>(harmonics[index]), sum);
    }
    return sum;
}

fn colours_of(logits: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(colour_of(logits.x), colour_of(logits.y), colour_of(logits.z));
}

