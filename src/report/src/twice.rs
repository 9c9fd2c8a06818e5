//! Numbers that stand twice in a report. Those of a real run are compared in `tests/demo.rs`.

use super::fixture::full;

/// Returns the number right after a text.
fn number_after<'h>(html: &'h str, before: &str) -> &'h str {
    let (_, rest) = html.split_once(before).unwrap_or_else(|| panic!("no `{before}`"));
    let end = rest
        .find(|letter: char| !letter.is_ascii_digit() && letter != '.')
        .unwrap();
    &rest[..end]
}

#[test]
fn an_interval_covers_in_its_text_what_it_covers_in_its_chart_and_in_its_table() {
    let (store, nodes) = full();
    let html = store.report(&nodes);
    let row = html
        .split_once("errors inside at places it was not fitted on")
        .unwrap()
        .1;
    let cells: Vec<&str> = row.split("<td class=\"number\">").skip(1).collect();
    for (column, line, key) in [
        (0, "gray levels", "calibration"),
        (1, "depth", "depth_calibration"),
    ] {
        let in_chart = format!("<title>{line} stated share, % 90, errors inside, % ");
        let shown = number_after(cells[column], "");
        assert_eq!(shown, number_after(&html, &in_chart), "{line}");
        // In the folded JSON, in which quotes are escaped.
        let heldout = html.split_once("&quot;heldout&quot;: {").unwrap().1;
        let calibration = heldout.split_once(&format!("&quot;{key}&quot;: {{")).unwrap().1;
        let share: f64 = number_after(calibration, "&quot;coverage90&quot;: ")
            .parse()
            .unwrap();
        assert!(
            (100.0 * share - shown.parse::<f64>().unwrap()).abs() < 1e-9,
            "{share} {shown}"
        );
    }
}

/// Reads a duration at the start of a text, in seconds.
fn seconds_at(text: &str) -> f64 {
    let text = text.split(['<', ',']).next().unwrap();
    let words: Vec<&str> = text.split_whitespace().collect();
    let of = |pair: &[&str]| {
        let unit = match pair[1].trim_end_matches('.') {
            "ms" => 0.001,
            "s" => 1.0,
            "min" => 60.0,
            unit => panic!("{unit}: {text}"),
        };
        pair[0].parse::<f64>().unwrap() * unit
    };
    words.chunks_exact(2).map(of).sum()
}

#[test]
fn the_time_of_a_run_is_the_sum_of_the_times_of_the_nodes_that_ran() {
    let (store, nodes) = full();
    let html = store.report(&nodes);
    let of_rows: f64 = html
        .split("<span class=\"badge ran\">ran</span></td><td class=\"number\">")
        .skip(1)
        .map(seconds_at)
        .sum();
    let total = html.split_once("1 skipped, ").unwrap().1;
    let total = seconds_at(total.split_once(" of work in ").unwrap().0);
    // Each row is rounded by at most half a second.
    assert!((total - of_rows).abs() <= 2.0, "{total} {of_rows}");
}
