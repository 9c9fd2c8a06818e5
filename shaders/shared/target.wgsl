// What a ray is compared with. marf_shaders::Target writes it, too.
struct Target {
    // The pixel, sRGB over black.
    rgb: vec3<f32>,
    // Number of the view.
    view: u32,
    // sRGB that is put behind the last sample.
    behind: vec3<f32>,
    // How much of it the pixel shows. Below 0 the background is behind.
    share: f32,
}
