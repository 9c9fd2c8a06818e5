//! Summary of the verdicts of a node. It is kept block by block, so that after a new sol the page reads the
//! verdicts of that sol's block alone.

use std::collections::{BTreeMap, BTreeSet};

use marf_cache::Digest;
use marf_cache::manifest::BlockRef;
use marf_stage::Verdict;
use serde::{Deserialize, Serialize};

use super::call::{Call, FACTORS};
use super::format::count;
use super::photos::{Spot, remembered};
use super::read::Missing;
use super::report::Report;
use super::sets::Set;

/// Most rejections of a node that are shown one by one.
pub(super) const MOST_REJECTED: usize = 30;
/// Closest calls of a node that are shown.
const CLOSEST: usize = 6;
/// A score further from its threshold than this share of it is not a close call.
const NEAR: f64 = 0.5;
/// Version of the memos: to be raised when the same verdicts would be summed up otherwise.
const VERSION: u32 = 2;

/// A verdict, and the sol of its photo.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Judged {
    pub(super) shard: u32,
    pub(super) verdict: Verdict,
}

/// A sum over verdicts in the order of their set. [`Summary::append`] adds the following ones.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Summary {
    /// Verdicts.
    pub(super) seen: usize,
    /// Those that keep their photo.
    pub(super) kept: usize,
    /// How often each kind of rejection fell.
    pub(super) rejected: BTreeMap<String, u64>,
    /// How many photos are kept as another kind, by kind and group.
    pub(super) kept_as: BTreeMap<String, BTreeMap<String, usize>>,
    /// The first rejections.
    pub(super) first_rejected: Vec<Judged>,
    /// Decisions of a person against the filter.
    pub(super) by_hand: Vec<Judged>,
    /// Verdicts that rest on a score and a threshold.
    pub(super) calls: usize,
    /// Those of them that reject.
    pub(super) calls_rejected: usize,
    /// How many of them would change with the threshold times each of [`FACTORS`].
    pub(super) flips: [usize; FACTORS.len()],
    /// How many of them lie within half of their threshold.
    pub(super) near: usize,
    /// The nearest of these, nearest first.
    pub(super) closest: Vec<Judged>,
}

impl Summary {
    /// Sums up the verdicts of a set, from what earlier reports kept of its blocks.
    pub(super) fn new(report: &Report<'_>, set: &Set<'_>) -> Result<Self, Missing> {
        let mut sum = Self::default();
        for block in &set.blocks {
            let key = Digest::from_content(format!("verdicts {VERSION} {}", block.digest).as_bytes());
            sum.append(remembered(report, &key, || of_block(set, block))?);
        }
        Ok(sum)
    }

    /// Photos whose pictures or names the page shows because of these verdicts.
    pub(super) fn spots(&self) -> impl Iterator<Item = Spot> {
        let shown = self.first_rejected.iter().chain(&self.closest);
        shown.flat_map(|Judged { shard, verdict }| {
            let ids = std::iter::once(&verdict.id).chain(&verdict.twin);
            ids.map(|id| (*shard, id.clone()))
        })
    }

    fn add(&mut self, shard: u32, verdict: Verdict) {
        self.seen += 1;
        self.kept += usize::from(verdict.keeps());
        if let Some(call) = Call::from_verdict(&verdict) {
            self.calls += 1;
            self.calls_rejected += usize::from(!verdict.keeps());
            for (flips, factor) in self.flips.iter_mut().zip(FACTORS) {
                *flips += usize::from(call.flips_at(factor));
            }
            self.near += usize::from(call.margin().abs() <= NEAR);
        }
        if let Some((kind, group)) = verdict.kept_as() {
            let groups = self.kept_as.entry(kind.to_owned()).or_default();
            *groups.entry(group.to_owned()).or_default() += 1;
        }
        let judged = Judged { shard, verdict };
        if distance(&judged) <= NEAR {
            self.closest.push(judged.clone());
            self.cut_closest();
        }
        let reason = &judged.verdict.reason;
        if reason.starts_with("kept by hand, against") || reason.starts_with("rejected by hand") {
            self.by_hand.push(judged.clone());
        }
        if !judged.verdict.keeps() {
            *self.rejected.entry(judged.verdict.verdict.clone()).or_default() += 1;
            if self.first_rejected.len() < MOST_REJECTED {
                self.first_rejected.push(judged);
            }
        }
    }

    /// Adds the sum over verdicts that come behind these.
    fn append(&mut self, next: Self) {
        self.seen += next.seen;
        self.kept += next.kept;
        for (kind, count) in next.rejected {
            *self.rejected.entry(kind).or_default() += count;
        }
        for (kind, groups) in next.kept_as {
            let own = self.kept_as.entry(kind).or_default();
            for (group, count) in groups {
                *own.entry(group).or_default() += count;
            }
        }
        self.first_rejected.extend(next.first_rejected);
        self.first_rejected.truncate(MOST_REJECTED);
        self.by_hand.extend(next.by_hand);
        self.calls += next.calls;
        self.calls_rejected += next.calls_rejected;
        for (flips, more) in self.flips.iter_mut().zip(next.flips) {
            *flips += more;
        }
        self.near += next.near;
        self.closest.extend(next.closest);
        self.cut_closest();
    }

    /// Returns one line for each kind and group of photos that are kept as another kind.
    pub(super) fn kept_as_lines(&self) -> impl Iterator<Item = String> + '_ {
        let kinds = self.kept_as.iter();
        kinds.flat_map(|(kind, groups)| {
            let line = move |(group, photos): (&String, &usize)| {
                format!("kept as {kind}: {} of {group}", count(*photos, "photo"))
            };
            groups.iter().map(line)
        })
    }

    fn cut_closest(&mut self) {
        self.closest.sort_by(|a, b| {
            let nearer = distance(a).total_cmp(&distance(b));
            nearer.then_with(|| a.verdict.id.cmp(&b.verdict.id))
        });
        self.closest.truncate(CLOSEST);
    }
}

/// Distance of a score from its threshold, as a share of it. Infinite without a score.
fn distance(judged: &Judged) -> f64 {
    Call::from_verdict(&judged.verdict).map_or(f64::INFINITY, |call| call.margin().abs())
}

fn of_block(set: &Set<'_>, block: &BlockRef) -> Result<Summary, Missing> {
    let mut sum = Summary::default();
    for leaf in set.leaves(block)? {
        for verdict in set.verdicts(&leaf)? {
            sum.add(leaf.shard, verdict);
        }
    }
    Ok(sum)
}

/// The verdict on a photo that was closest to falling the other way: name of the node, verdict, margin.
pub(super) type ClosestCall<'a> = (&'a str, Verdict, f64);

/// Returns the closest call on each of some photos, over all nodes.
pub(super) fn closest_calls<'s, 'a: 's>(
    sets: impl Iterator<Item = &'s Set<'a>>,
    spots: &BTreeSet<Spot>,
) -> BTreeMap<String, ClosestCall<'a>> {
    let ids: BTreeSet<&str> = spots.iter().map(|(_, id)| id.as_str()).collect();
    let shards: BTreeSet<u32> = spots.iter().map(|(shard, _)| *shard).collect();
    let mut closest: BTreeMap<String, ClosestCall<'a>> = BTreeMap::new();
    for (set, shard) in sets.flat_map(|set| shards.iter().map(move |shard| (set, *shard))) {
        // The summary reports unreadable leaves. For a kept sum only the caption is missing.
        let leaves = set.leaves_of(shard).unwrap_or_default();
        let verdicts = leaves
            .iter()
            .flat_map(|leaf| set.verdicts(leaf).unwrap_or_default());
        for verdict in verdicts.filter(|verdict| ids.contains(verdict.id.as_str())) {
            let Some(call) = Call::from_verdict(&verdict) else {
                continue;
            };
            let margin = call.margin();
            let known = closest.get(&verdict.id);
            if known.is_none_or(|(_, _, known)| margin.abs() < known.abs()) {
                closest.insert(verdict.id.clone(), (set.node(), verdict, margin));
            }
        }
    }
    closest
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    prop_compose! {
        fn judged()(shard in 0..200_u32, id in 0..50_u32, kind in 0..3_usize, score in 0.0..3.0, by_hand in 0..9_usize) -> Judged {
            let verdict = Verdict {
                id: id.to_string(),
                file: String::new(),
                verdict: ["keep", "blur", "size"][kind].to_owned(),
                score: Some(score),
                threshold: Some(1.0),
                twin: None,
                reason: match by_hand {
                    0 => "rejected by hand".to_owned(),
                    1 | 2 => Verdict::kept_as_reason("monochrome", ["NLA", "NRA"][by_hand - 1]),
                    _ => String::new(),
                },
            };
            Judged { shard, verdict }
        }
    }

    fn sum(all: &[Judged]) -> Summary {
        let mut sum = Summary::default();
        for judged in all {
            sum.add(judged.shard, judged.verdict.clone());
        }
        sum
    }

    proptest! {
        #[test]
        fn a_sum_of_parts_is_the_sum_of_the_whole(all in prop::collection::vec(judged(), 0..200), cut in 0..200_usize) {
            let (first, rest) = all.split_at(cut.min(all.len()));
            let mut parts = sum(first);
            parts.append(sum(rest));
            prop_assert_eq!(parts, sum(&all));
        }
    }

    #[test]
    fn a_summary_counts_and_keeps_the_nearest() {
        let judged = |id: &str, kind: &str, score: f64| Judged {
            shard: 7,
            verdict: Verdict {
                id: id.to_owned(),
                file: id.to_owned(),
                verdict: kind.to_owned(),
                score: Some(score),
                threshold: Some(10.0),
                twin: (id == "c").then(|| "t".to_owned()),
                reason: String::new(),
            },
        };
        let all = [
            judged("a", "keep", 30.0),
            judged("b", "keep", 10.4),
            judged("c", "blur", 9.0),
            judged("d", "blur", 4.0),
        ];
        let sum = sum(&all);
        assert_eq!((sum.seen, sum.kept, sum.calls, sum.calls_rejected), (4, 2, 4, 2));
        assert_eq!(sum.rejected, BTreeMap::from([("blur".to_owned(), 2)]));
        // 0.8 and 0.9 keep c as well (9.0 is not less than 8 and 9), 0.95 does not. 1.05 rejects b.
        assert_eq!(sum.flips, [1, 1, 0, 1, 1, 1]);
        assert_eq!(sum.near, 2);
        assert_eq!(sum.closest, [all[1].clone(), all[2].clone()]);
        let spots: Vec<Spot> = sum.spots().collect();
        for id in ["b", "c", "d", "t"] {
            assert!(spots.contains(&(7, id.to_owned())), "{id}");
        }
    }
}
