//! `map-correlation`: the maps of two bootstraps of one scene that share no member.

use std::{fs, path::Path};

use serde_json::json;

use super::maps::array;
use crate::output::{Result, print_json};

const KINDS: [&str; 3] = ["std", "total", "depth-std"];

/// Prints the correlation of the maps in two folders, a line a kind.
pub fn correlation(first: &Path, second: &Path) -> Result {
    for kind in KINDS {
        let mut found = Vec::new();
        for name in names(first, kind)? {
            let file = format!("{name}-{kind}.npy");
            let (a, b) = (array(&first.join(&file))?, array(&second.join(&file))?);
            if a.columns != b.columns || a.values.len() != b.values.len() {
                return Err(format!("{file} has another size in the second folder").into());
            }
            found.push(pearson(&a.values, &b.values));
        }
        let mean = found.iter().sum::<f64>() / found.len().max(1) as f64;
        let least = found.iter().copied().fold(f64::INFINITY, f64::min);
        print_json(&json!({"map": kind, "views": found.len(), "mean": mean, "least": least}))?;
    }
    Ok(())
}

/// Returns the views that have a map of this kind. Views of every kind have a map `coverage`.
fn names(folder: &Path, kind: &str) -> Result<Vec<String>> {
    let mut names = Vec::new();
    for entry in fs::read_dir(folder)? {
        let name = entry?.file_name().to_string_lossy().into_owned();
        let view = name.strip_suffix("-coverage.npy").map(str::to_owned);
        names.extend(view.filter(|view| folder.join(format!("{view}-{kind}.npy")).is_file()));
    }
    names.sort();
    Ok(names)
}

/// Returns the correlation (Pearson) of two maps at the pixels that have a value in both: negative ones have none.
fn pearson(a: &[f32], b: &[f32]) -> f64 {
    let pairs = a.iter().zip(b).filter(|(a, b)| **a >= 0.0 && **b >= 0.0);
    let pairs: Vec<(f64, f64)> = pairs.map(|(a, b)| (f64::from(*a), f64::from(*b))).collect();
    let count = pairs.len().max(1) as f64;
    let mean = |value: fn(&(f64, f64)) -> f64| pairs.iter().map(value).sum::<f64>() / count;
    let (mean_a, mean_b) = (mean(|pair| pair.0), mean(|pair| pair.1));
    let sums = pairs.iter().fold((0.0, 0.0, 0.0), |(ab, aa, bb), (a, b)| {
        let (a, b) = (a - mean_a, b - mean_b);
        (ab + a * b, aa + a * a, bb + b * b)
    });
    sums.0 / (sums.1 * sums.2).sqrt()
}
