//! From what `benches/gpu.sh run` left in a folder to Markdown.

use std::error::Error;
use std::fs;
use std::path::Path;

use serde::de::DeserializeOwned;
use serde_json::Value;

use super::measured::Line;
use super::table;

/// Prints what is there: machine, kernels and pictures, tests, repeated trainings, quality by the clock.
pub fn collect(folder: &Path) -> Result<(), Box<dyn Error>> {
    if !folder.is_dir() {
        return Err(format!("{} is no folder", folder.display()).into());
    }
    parts(folder)?;
    println!("\n## Kernels, ceilings and model");
    for line in lines::<Line>(&folder.join("bench.jsonl"))? {
        match line {
            Line::Kernels(kernels) => print!("\n{}", table::kernels(&kernels)),
            Line::View(view) => print!("\n{}", table::view(&view)),
        }
    }
    tests(&lines(&folder.join("tests.jsonl"))?);
    twice(&lines(&folder.join("twice.jsonl"))?);
    quality(&lines(&folder.join("quality.jsonl"))?);
    Ok(())
}

/// Reads a value a line. Empty if the file does not exist.
fn lines<T: DeserializeOwned>(path: &Path) -> Result<Vec<T>, Box<dyn Error>> {
    if !path.exists() {
        return Ok(Vec::new());
    }
    let text = fs::read_to_string(path)?;
    let read = |(at, line): (usize, &str)| {
        serde_json::from_str(line).map_err(|error| format!("{}:{}: {error}", path.display(), at + 1).into())
    };
    text.lines().enumerate().map(read).collect()
}

/// Prints how every part of the runs ended.
fn parts(folder: &Path) -> Result<(), Box<dyn Error>> {
    let mut rows = Vec::new();
    for call in ["first", "second"] {
        for part in lines::<Value>(&folder.join(format!("{call}.jsonl")))? {
            rows.push(format!(
                "| {call} | {} | {} | {} |",
                word(&part["part"]),
                part["exit"],
                part["seconds"]
            ));
        }
    }
    println!("## Calls\n\n| call | part | exit code, 124 where its time was over | s |\n|---|---|---|---|");
    println!("{}", rows.join("\n"));
    Ok(())
}

fn word(value: &Value) -> &str {
    value.as_str().unwrap_or("-")
}

fn tests(found: &[Value]) {
    let passed = found.iter().filter(|test| test["result"] == "ok").count();
    println!(
        "\n## Kernels against their twins\n\n{passed} of {} tests pass.",
        found.len()
    );
    for test in found.iter().filter(|test| test["result"] != "ok") {
        println!("- `{}`: {}", word(&test["test"]), word(&test["result"]));
    }
}

fn twice(found: &[Value]) {
    println!(
        "\n## The same training twice\n\n| scene | steps | digest of the checkpoint | M samples/s |\n|---|---|---|---|"
    );
    for line in found {
        println!(
            "| {} | {} | `{}` | {:.2} |",
            word(&line["scene"]),
            line["steps"],
            word(&line["checkpoint"]),
            number(&line["samples_per_s"]) / 1e6
        );
    }
    let digests: Vec<&Value> = found.iter().map(|line| &line["checkpoint"]).collect();
    let verdict = match digests.as_slice() {
        [first, others @ ..] if !others.is_empty() && others.iter().all(|other| other == first) => {
            "The bytes are the same."
        }
        [_, _, ..] => "**The bytes differ.**",
        _ => "Not run twice.",
    };
    println!("\n{verdict}");
}

fn quality(found: &[Value]) {
    println!(
        "\n## Quality by the clock\n\n| scene | budget | PSNR, dB | SSIM | steps | batch | log2 of the table | M samples/s | a view, ms | M rays/s |\n|---|---|---|---|---|---|---|---|---|---|"
    );
    for line in found {
        println!(
            "| {} | {} s | {:.2} | {:.3} | {} | {} | {} | {:.2} | {:.0} | {:.2} |",
            word(&line["scene"]),
            line["budget"],
            number(&line["psnr"]),
            number(&line["ssim"]),
            line["steps"],
            line["batch_samples"],
            line["log2_table"],
            number(&line["samples_per_s"]) / 1e6,
            1e3 * number(&line["render_s"]),
            number(&line["render_rays_per_s"]) / 1e6
        );
    }
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}
