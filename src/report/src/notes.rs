//! What to know of a run: which photos were rejected, and where new views were judged.

use marf_schema::scores::Scores;

use super::format::count;
use super::page::Page;
use super::quality::rounded;

/// Says how many held-out photos look where no other does. `None` if none do.
pub(super) fn extrapolation_words(scores: &Scores) -> Option<String> {
    let extrapolated = scores.apart.as_ref()?.extrapolated;
    let judged = count(scores.views.len(), "held-out photo");
    (extrapolated > 0).then(|| format!("{extrapolated} of {judged} look where no photo trained on does."))
}

/// Says how many photos each filter rejected. `None` if none did.
pub(super) fn rejected_words(page: &Page<'_>) -> Option<String> {
    let judged = page.judged().filter_map(|(node, sum)| Some((node, sum.ok()?)));
    let rejected: Vec<(&str, usize)> = judged
        .map(|(node, sum)| (node.run.name.as_str(), sum.seen - sum.kept))
        .filter(|(_, rejected)| *rejected > 0)
        .collect();
    let all: usize = rejected.iter().map(|(_, rejected)| rejected).sum();
    let each: Vec<String> = rejected
        .iter()
        .map(|(name, rejected)| format!("{rejected} by {name}"))
        .collect();
    (all > 0).then(|| format!("Photos rejected: {all} ({}).", each.join(", ")))
}

/// Says how far from photos trained on the judged views are at most, which is where a viewer may stand.
pub(super) fn reach_words(scores: &Scores) -> Option<String> {
    let nearest = || scores.views.iter().filter_map(|view| view.nearest.as_ref());
    let most = |values: Vec<f64>| values.into_iter().reduce(f64::max);
    let angle_deg = most(nearest().map(|nearest| nearest.angle_deg).collect())?;
    let metres = nearest()
        .map(|nearest| nearest.distance_m)
        .collect::<Option<Vec<f64>>>();
    let distance = match metres.and_then(most) {
        Some(metres) => format!("{} m", rounded(metres)),
        None => format!(
            "{} units",
            rounded(most(nearest().map(|nearest| nearest.distance).collect())?)
        ),
    };
    Some(format!(
        "Views were judged up to {distance} and {angle_deg:.0}° from a photo trained on. Farther away errors are not known."
    ))
}

/// Returns the mean share of held-out photos that no photo trained on shows from within 30 degrees.
pub(super) fn unseen_share(scores: &Scores) -> Option<f64> {
    let shares = scores
        .views
        .iter()
        .filter_map(|view| Some(view.nearest.as_ref()?.uncovered_share));
    let shares: Vec<f64> = shares.collect();
    (!shares.is_empty()).then(|| shares.iter().sum::<f64>() / shares.len() as f64)
}
