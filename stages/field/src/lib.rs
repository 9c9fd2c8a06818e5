//! The radiance field: hash grid, MLPs, compositing, Adam, marching.
