//! The script of a job.

use std::path::Path;

/// The script of a Slurm job. `SIGTERM` comes a minute before the end of its time, so that it leaves a checkpoint.
pub(crate) const SLURM: &str = "\
#!/bin/bash
#SBATCH --job-name={name}
#SBATCH --output={log}
#SBATCH --open-mode=append
#SBATCH --cpus-per-task={cores}
#SBATCH --mem={memory_mb}M
#SBATCH --time={minutes}
#SBATCH --signal=TERM@60
#SBATCH --requeue
#SBATCH {options}
exec {marf} exec {action} --store {store} --result {result} --scratch {scratch} --threads {cores}
";

/// The placeholder of further options: its line stands once for each of them.
const OPTIONS: &str = "{options}";

/// Placeholders without which a job would do nothing, or nothing that is found.
const NEEDED: [&str; 4] = ["{name}", "{action}", "{store}", "{result}"];

/// Values of the placeholders of a script.
pub(crate) struct Filling<'a> {
    pub name: &'a str,
    pub action: &'a Path,
    pub store: &'a str,
    pub marf: &'a Path,
    pub log: &'a Path,
    pub result: &'a Path,
    pub scratch: &'a Path,
    pub cores: usize,
    pub memory_mb: u64,
    pub minutes: u64,
    pub options: &'a [String],
}

/// Checks that a template has what jobs with these options need.
///
/// # Errors
/// What it lacks.
pub(crate) fn check(template: &str, options: &[String]) -> Result<(), String> {
    if let Some(absent) = NEEDED.iter().find(|word| !template.contains(**word)) {
        return Err(format!("no {absent}: each script of a job needs it"));
    }
    match options {
        [option, ..] if !template.contains(OPTIONS) => Err(format!(
            "no line with {OPTIONS}, for the option `{option}` of the site file"
        )),
        _ => Ok(()),
    }
}

/// Returns a script with its placeholders filled. Values in a command line are quoted for the shell.
pub(crate) fn filled(template: &str, filling: &Filling<'_>) -> String {
    let pairs = [
        ("{name}", filling.name.to_owned()),
        ("{action}", quoted_path(filling.action)),
        ("{store}", shell_quoted(filling.store)),
        ("{marf}", quoted_path(filling.marf)),
        ("{log}", quoted_path(filling.log)),
        ("{result}", quoted_path(filling.result)),
        ("{scratch}", quoted_path(filling.scratch)),
        ("{cores}", filling.cores.to_string()),
        ("{memory_mb}", filling.memory_mb.to_string()),
        ("{minutes}", filling.minutes.to_string()),
    ];
    let lines = template.lines().flat_map(|line| {
        if line.contains(OPTIONS) {
            let options = filling.options.iter();
            let pairs = options.map(|option| [pairs.as_slice(), &[(OPTIONS, option.clone())]].concat());
            pairs.map(|pairs| with_values(line, &pairs)).collect()
        } else {
            vec![with_values(line, &pairs)]
        }
    });
    lines.map(|line| line + "\n").collect()
}

/// Replaces the placeholders of a line. A value is not looked at again: a placeholder in it stays.
fn with_values(line: &str, pairs: &[(&str, String)]) -> String {
    let (mut filled, mut rest) = (String::new(), line);
    while let Some(start) = rest.find('{') {
        let (before, from) = rest.split_at(start);
        let pair = pairs
            .iter()
            .find(|(placeholder, _)| from.starts_with(placeholder));
        let (length, value) = pair.map_or((1, "{"), |(placeholder, value)| (placeholder.len(), value));
        filled.extend([before, value]);
        rest = &from[length..];
    }
    filled + rest
}

/// Returns this path as a word of a shell command.
fn quoted_path(path: &Path) -> String {
    shell_quoted(&path.display().to_string())
}

/// Returns this text as a word of a shell command.
fn shell_quoted(text: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "/._-:=@".contains(c);
    if !text.is_empty() && text.chars().all(is_plain) {
        text.to_owned()
    } else {
        format!("'{}'", text.replace('\'', r"'\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_script_has_every_value_and_quotes_what_a_shell_would_take_apart() {
        let options = ["--partition=long".to_owned(), "--gres=gpu:1".to_owned()];
        let filling = Filling {
            name: "marf-ab",
            action: Path::new("/jobs/a.action"),
            store: "file:///shared/my store",
            marf: Path::new("/opt/marf"),
            log: Path::new("/jobs/a.log"),
            result: Path::new("/jobs/it's.json"),
            scratch: Path::new("/jobs/a"),
            cores: 2,
            memory_mb: 900,
            minutes: 30,
            options: &options,
        };
        let script = filled(SLURM, &filling);
        assert!(!script.contains('{'), "{script}");
        assert!(script.starts_with("#!/bin/bash\n#SBATCH --job-name=marf-ab\n"));
        assert!(script.contains(
            "\n#SBATCH --partition=long\n#SBATCH --gres=gpu:1\nexec /opt/marf exec /jobs/a.action "
        ));
        assert!(script.contains(" --store 'file:///shared/my store' "));
        assert!(script.contains(r" --result '/jobs/it'\''s.json' "));
        assert!(script.ends_with(" --threads 2\n"));
        let options = &[];
        let bare = filled(SLURM, &Filling { options, ..filling });
        assert!(!bare.contains("\n\n"), "{bare}");
        assert_eq!(shell_quoted(""), "''");
    }

    #[test]
    fn values_are_words_in_every_line_and_placeholders_in_them_stay() {
        let filling = Filling {
            name: "marf-ab",
            action: Path::new("/a b/{store}"),
            store: "file:///x'; touch y; '{marf}",
            marf: Path::new("/$(touch z)/marf"),
            log: Path::new("/a b/{store}.log"),
            result: Path::new("/r"),
            scratch: Path::new("/s"),
            cores: 2,
            memory_mb: 900,
            minutes: 30,
            options: &["--comment={name}".to_owned()],
        };
        let script = filled(SLURM, &filling);
        for line in [
            "#SBATCH --output='/a b/{store}.log'",
            "#SBATCH --comment={name}",
            r"exec '/$(touch z)/marf' exec '/a b/{store}' --store 'file:///x'\''; touch y; '\''{marf}' --result /r --scratch /s --threads 2",
        ] {
            assert!(script.lines().any(|found| found == line), "{line}: {script}");
        }
    }

    #[test]
    fn a_template_without_what_a_job_needs_is_told_what_it_lacks() {
        let option = ["-q long".to_owned()];
        assert_eq!(check(SLURM, &option), Ok(()));
        assert_eq!(check("{name} {action} {store} {result}", &[]), Ok(()));
        for (template, expected) in [
            ("", "no {name}"),
            ("{name} {action} {store}", "no {result}"),
            (
                "{name} {action} {store} {result}",
                "no line with {options}, for the option `-q long`",
            ),
        ] {
            let refused = check(template, &option).unwrap_err();
            assert!(refused.starts_with(expected), "{refused}");
        }
    }
}
