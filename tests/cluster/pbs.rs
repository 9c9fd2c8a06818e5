//! Jobs by the example site of PBS, and a stub that reads and prints what PBS does.

use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;

use super::{PIPELINE, Site, calibrated, outputs};
use crate::common::marf;

/// Refuses directives that PBS does not have. The first job is stopped for its memory.
const QSUB: &str = r#"#!/bin/bash
cd "$(dirname "$0")" || exit 1
unknown=$(sed -n 's/^#PBS //p' "$1" | grep -vE '^(-N [^ ]+|-j oe|-o /[^ ]+|-l select=1:ncpus=[0-9]+:mem=[0-9]+mb|-l walltime=[0-9]+:00|-r y|-q [a-z]+)$')
[ -n "$unknown" ] && { echo "qsub: illegally formed job directive: $unknown" >&2; exit 2; }
exec 9> lock; flock 9
number=$(( $(cat next 2> /dev/null || echo 11) + 1 )); echo $number > next
flock -u 9
id=$number.stub; mkdir -p jobs; cp "$1" jobs/$id; cat "$1" >> scripts
( sleep 0.2; [ $number = 12 ] || setsid bash jobs/$id > jobs/$id.log 2>&1; rm jobs/$id ) 9>&- > /dev/null 2>&1 < /dev/null &
echo $id
"#;

const QSTAT: &str = r#"#!/bin/bash
cd "$(dirname "$0")" || exit 1
full() {
  printf 'Job Id: %s\n    Job_Name = %s\n    Job_Owner = %s@login\n    job_state = %s\n    queue = workq\n' "$@"
  printf '    comment = Not Running: Insufficient amount of resource: ncpus (R: 1 A: 0\n\t T: 2)\n    Variable_List = PBS_O_HOME=/home,\n\tPBS_O_SHELL=/bin/bash\n\n'
}
[ "$*" = "-x -f 12.stub" ] && { full 12.stub marf "$(id -un)" F; echo '    Exit_status = -27'; exit; }
[ "$*" = -f ] || { echo "qstat: illegal option" >&2; exit 2; }
full 3.stub tea somebody R
for job in jobs/*.stub; do
  [ -f "$job" ] && full "${job#jobs/}" "$(sed -n 's/^#PBS -N //p' "$job")" "$(id -un)" Q
done
exit 0
"#;

fn with_pbs() -> Site {
    let site = Site::new(PIPELINE);
    for (name, script) in [("qsub", QSUB), ("qstat", QSTAT)] {
        let path = site.stub().join(name);
        std::fs::write(&path, script).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
    }
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/cluster/pbs");
    let template = site.path().join("job.sh");
    std::fs::copy(example.join("job.sh"), &template).unwrap();
    let text = std::fs::read_to_string(example.join("site.toml")).unwrap();
    let own = |name: &str| site.path().join(name).display().to_string();
    let program = |name: &str| site.stub().join(name).display().to_string();
    let text = text
        .replace("/shared/marf-jobs", &own("jobs"))
        .replace("/shared/marf", &own("shared"))
        .replace("/shared/job.sh", &own("job.sh"))
        .replace("qsub", &program("qsub"))
        .replace("qstat", &program("qstat"))
        .replace(
            "[executor]\n",
            "[executor]\npoll_s = 0.1\npatience_s = 1.0\ncores = 1\nmemory_mb = 700\n",
        );
    std::fs::write(site.path().join("site.toml"), text).unwrap();
    site
}

/// The files of `src/cluster/pbs` submit, find and explain jobs of PBS: one that had too little memory is submitted with twice as much.
#[test]
fn the_example_of_pbs_runs_a_training_whose_first_job_had_too_little_memory() {
    let site = with_pbs();
    let ran = site.run(&["--to", "train"]).exits(0);
    assert!(ran.stderr.contains("is submitted with 1.4 GB"), "{}", ran.stderr);
    let scripts = std::fs::read_to_string(site.stub().join("scripts")).unwrap();
    assert_eq!(scripts.matches("#PBS -q workq\n").count(), 2, "{scripts}");
    assert!(
        scripts.contains("ncpus=1:mem=1400mb\n#PBS -l walltime=240:00\n"),
        "{scripts}"
    );

    let local = tempfile::tempdir().unwrap();
    crate::common::copy(calibrated(), local.path());
    marf(local.path(), &["run", "--to", "train"]).exits(0);
    assert_eq!(outputs(site.path())["train"], outputs(local.path())["train"]);
}

/// A template that would lose the options of the site is refused before anything is submitted.
#[test]
fn a_template_that_lacks_what_the_site_asks_for_is_a_usage_error() {
    let site = with_pbs();
    let template = site.path().join("job.sh");
    let text = std::fs::read_to_string(&template).unwrap();
    std::fs::write(&template, text.replace("#PBS {options}\n", "")).unwrap();
    let refused = site.run(&["--to", "train"]).exits(2).stderr;
    assert!(
        refused.contains("job.sh: no line with {options}, for the option `-q workq`"),
        "{refused}"
    );
    assert_eq!(site.noted("scripts"), [] as [&str; 0]);
}
