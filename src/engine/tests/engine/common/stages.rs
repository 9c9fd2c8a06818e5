//! Small stages: an archive, a filter, a fold, a sum, a draw, an expansion, and one that fails.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::atomic::Ordering,
    time::Duration,
};

use marf_cache::{
    Digest, digest_of,
    manifest::{ManifestError, Root, Row},
};
use marf_stage::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::fixture::{FixtureId, fixture};

macro_rules! stage {
    ($stage:ident, $params:ident { $($field:ident : $ty:ty),* }, $name:literal, $version:literal,
     [$($port:expr),*], [$($output:expr),*], $work:ident, $threads:expr) => {
        #[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
        #[serde(deny_unknown_fields)]
        pub struct $params { pub fixture: FixtureId, $(pub $field: $ty),* }
        pub struct $stage(pub $params);
        impl Stage for $stage {
            fn params(&self) -> serde_json::Value { key_params(&self.0, &["fixture"]) }
            fn work(&self) -> Work<'_> { Work::$work(self) }
            fn threads(&self) -> Threads { $threads }
        }
        impl Define for $stage {
            type Params = $params;
            const NAME: &'static str = $name;
            const ABOUT: &'static str = "a stage of a test";
            const VERSION: u32 = $version;
            const PORTS: &'static [Port] = &[$($port),*];
            const OUTPUTS: &'static [&'static str] = &[$($output),*];
            fn new(params: $params) -> Result<Self, ParamError> { Ok(Self(params)) }
        }
    };
}

const INPUT: Port = Port::required("input", PHOTOS);
stage!(
    Archive,
    ArchiveParams {},
    "archive",
    1,
    [],
    [PHOTOS, VERDICTS, COMPANIONS],
    Source,
    Threads::One
);
stage!(
    AtMost,
    AtMostParams { most: u64 },
    "at_most",
    1,
    [INPUT],
    [PHOTOS, VERDICTS],
    Map,
    Threads::All
);
stage!(
    Distinct,
    DistinctParams { by: u64 },
    "distinct",
    1,
    [INPUT],
    [PHOTOS, VERDICTS],
    Fold,
    Threads::All
);
stage!(
    Sum,
    SumParams { times: u64 },
    "sum",
    1,
    [INPUT, Port::optional("input", COMPANIONS)],
    ["sum"],
    Set,
    Threads::All
);
stage!(
    Draw,
    DrawParams { seed: u64 },
    "draw",
    1,
    [Port::required("input", "sum")],
    ["draw"],
    Set,
    Threads::One
);
stage!(
    Many,
    ManyParams { b: u64, unlucky: u64 },
    "many",
    1,
    [Port::required("input", "sum")],
    ["mean"],
    Expand,
    Threads::One
);
stage!(
    Broken,
    BrokenParams { how: String },
    "broken",
    1,
    [INPUT],
    ["sum"],
    Set,
    Threads::One
);

impl Source for Archive {
    fn list(&self, ctx: &Ctx<'_>) -> Result<Listing, StageError> {
        let fixture = fixture(self.0.fixture.0);
        let at_list = fixture.at_list.lock().clone();
        if let Some(at_list) = at_list {
            at_list();
            ctx.check()?;
        }
        let archive = fixture.archive.lock();
        if archive.is_empty() {
            return Err(StageError::new("the archive is empty").hint("fill it"));
        }
        let shards = archive.iter().map(|(shard, photos)| Shard {
            shard: *shard,
            fingerprint: digest_of(photos),
        });
        Ok(Listing {
            shards: shards.collect(),
            companions: BTreeMap::new(),
            note: (archive.len() > 2).then(|| format!("{} shards there", archive.len())),
            ..Listing::default()
        })
    }

    fn fetch(&self, ctx: &Ctx<'_>, shard: u32) -> Result<Fetched, StageError> {
        let fixture = fixture(self.0.fixture.0);
        fixture.fetched.lock().push(shard);
        let photos = fixture.archive.lock()[&shard].clone();
        let mut fetched = Fetched::default();
        for (name, number) in photos {
            let image = ctx.put(format!("image {number}").as_bytes())?;
            let blobs = BTreeMap::from([("image".to_owned(), image)]);
            fetched.rows.push(Row {
                id: name.clone(),
                blobs,
                facts: serde_json::json!({ "shard": shard }),
            });
            fetched.verdicts.push(verdict(&name, Keeps(true), None));
        }
        Ok(fetched)
    }
}

/// Whether a photo stays.
pub struct Keeps(pub bool);

pub fn verdict(id: &str, keeps: Keeps, score: Option<f64>) -> Verdict {
    Verdict {
        id: id.to_owned(),
        file: format!("{id}.png"),
        verdict: match keeps {
            Keeps(true) => Verdict::KEEP.to_owned(),
            Keeps(false) => "size".to_owned(),
        },
        score,
        threshold: None,
        twin: None,
        reason: String::new(),
    }
}

fn number_of(ctx: &Ctx<'_>, row: &Row) -> Result<u64, StageError> {
    let text = String::from_utf8(ctx.get(&row.blobs["image"])?.to_vec()).unwrap();
    Ok(text.strip_prefix("image ").unwrap().parse().unwrap())
}

pub fn measure_number(number: u64, ctx: &Ctx<'_>, row: &Row) -> Result<Vec<u8>, StageError> {
    let fixture = fixture(number);
    let before = {
        let mut measured = fixture.measured.lock();
        measured.push(row.id.clone());
        measured.len() - 1
    };
    if let Some(at_measure) = fixture.at_measure.lock().as_ref() {
        at_measure(before);
    }
    Ok(number_of(ctx, row)?.to_le_bytes().to_vec())
}

pub fn read(measure: &[u8]) -> u64 {
    u64::from_le_bytes(measure.try_into().unwrap())
}

impl Measure for AtMost {
    fn table(&self) -> Option<Table> {
        Some(Table {
            name: "at_most",
            version: 1,
        })
    }

    fn measure(&self, ctx: &Ctx<'_>, row: &Row, _wanted: &[Table]) -> Result<Vec<Vec<u8>>, StageError> {
        Ok(vec![measure_number(self.0.fixture.0, ctx, row)?])
    }
}

impl Map for AtMost {
    fn decide(&self, _context: &[u8], items: &[Measured<'_>]) -> Result<Vec<Verdict>, StageError> {
        let score = |item: &Measured<'_>| read(item.measure);
        let judge = |item: &Measured<'_>| {
            verdict(
                &item.row.id,
                Keeps(score(item) <= self.0.most),
                Some(score(item) as f64),
            )
        };
        Ok(items.iter().map(judge).collect())
    }
}

impl Measure for Distinct {
    fn table(&self) -> Option<Table> {
        Some(Table {
            name: "distinct",
            version: 1,
        })
    }

    fn measure(&self, ctx: &Ctx<'_>, row: &Row, _wanted: &[Table]) -> Result<Vec<Vec<u8>>, StageError> {
        Ok(vec![measure_number(self.0.fixture.0, ctx, row)?])
    }
}

impl Fold for Distinct {
    fn begin(&self) -> Box<dyn FoldState + '_> {
        Box::new(Seen {
            stage: self,
            seen: BTreeSet::new(),
        })
    }
}

/// The numbers seen so far.
struct Seen<'a> {
    stage: &'a Distinct,
    seen: BTreeSet<u64>,
}

impl FoldState for Seen<'_> {
    fn replay(&mut self, _ctx: &Ctx<'_>, added: &[u8]) -> Result<(), StageError> {
        let added: Vec<u64> = serde_json::from_slice(added).unwrap();
        self.seen.extend(added);
        Ok(())
    }

    fn fold(
        &mut self,
        _ctx: &Ctx<'_>,
        items: &[Measured<'_>],
    ) -> Result<(Vec<u8>, Vec<Verdict>), StageError> {
        let fixture = fixture(self.stage.0.fixture.0);
        fixture.folded.lock().extend(items.first().map(|item| item.shard));
        let mut added = Vec::new();
        let mut verdicts = Vec::new();
        for item in items {
            let number = read(item.measure) / self.stage.0.by;
            let is_new = self.seen.insert(number);
            added.extend(is_new.then_some(number));
            verdicts.push(verdict(&item.row.id, Keeps(is_new), None));
        }
        Ok((serde_json::to_vec(&added).unwrap(), verdicts))
    }
}

/// Why a set cannot be read.
#[derive(Debug)]
enum Fault {
    Stage(StageError),
    Manifest(#[allow(dead_code, reason = "printed on a panic")] ManifestError),
}

impl From<ManifestError> for Fault {
    fn from(error: ManifestError) -> Self {
        Self::Manifest(error)
    }
}

impl Set for Sum {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let fixture = fixture(self.0.fixture.0);
        fixture.ran.fetch_add(1, Ordering::Relaxed);
        fixture.sum_threads.lock().push(ctx.threads);
        let at_sum = fixture.at_sum.lock().clone();
        if let Some(at_sum) = at_sum {
            at_sum();
        }
        ctx.check()?;
        let root = Root::read(inputs.required(PHOTOS)?, |digest| {
            ctx.get(digest).map_err(Fault::Stage)
        });
        let root = match root {
            Err(Fault::Stage(error)) => return Err(error),
            other => other.unwrap(),
        };
        let mut sum = 0;
        for leaf in &root.leaves {
            for row in marf_cache::manifest::Leaf::decode(&ctx.get(&leaf.leaf)?)
                .unwrap()
                .rows
            {
                sum += number_of(ctx, &row)? * self.0.times;
            }
        }
        Ok(BTreeMap::from([(
            "sum".to_owned(),
            ctx.put(format!("sum {sum}").as_bytes())?,
        )]))
    }
}

impl Set for Draw {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let fixture = fixture(self.0.fixture.0);
        let before = fixture.ran.fetch_add(1, Ordering::Relaxed);
        let at_draw = fixture.at_draw.lock().clone();
        if let Some(at_draw) = at_draw {
            at_draw(before);
        }
        std::thread::sleep(Duration::from_millis(1)); // so that two of them overlap
        let sum = ctx.get(inputs.required("sum")?)?;
        if self.0.seed == 1313 {
            return Err(StageError::new("seed 1313 brings bad luck"));
        }
        let drawn = format!("{} {}", String::from_utf8_lossy(&sum), self.0.seed * 7 % 5);
        Ok(BTreeMap::from([("draw".to_owned(), ctx.put(drawn.as_bytes())?)]))
    }
}

impl Expand for Many {
    fn children(&self) -> Vec<ChildStage> {
        vec![ChildStage {
            stage: "draw",
            params: serde_json::json!({ "fixture": self.0.fixture.0, "seed": 0 }),
        }]
    }

    fn expand(&self, _ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Vec<NodeSpec>, StageError> {
        let spec = |seed: u64| NodeSpec {
            name: format!("member-{seed:02}"),
            stage: "draw".to_owned(),
            params: serde_json::json!({ "fixture": self.0.fixture.0, "seed": if seed == self.0.unlucky { 1313 } else { seed } }),
            inputs: inputs.clone(),
        };
        Ok((0..self.0.b).map(spec).collect())
    }

    fn reduce(&self, ctx: &Ctx<'_>, _inputs: &Inputs, children: &[Outputs]) -> Result<Outputs, StageError> {
        fixture(self.0.fixture.0).reduced.fetch_add(1, Ordering::Relaxed);
        let mut all = Vec::new();
        for child in children {
            all.extend_from_slice(&ctx.get(&child["draw"])?);
            all.push(b'\n');
        }
        Ok(BTreeMap::from([("mean".to_owned(), ctx.put(&all)?)]))
    }
}

impl Set for Broken {
    fn run(&self, ctx: &Ctx<'_>, _inputs: &Inputs) -> Result<Outputs, StageError> {
        match self.0.how.as_str() {
            "panics" => panic!("index 7 of 3"),
            "forgets" => Ok(Outputs::new()),
            "invents" => Ok(BTreeMap::from([(
                "sum".to_owned(),
                Digest::from_content(b"never stored"),
            )])),
            "adds" => {
                let blob = ctx.put(b"x")?;
                Ok(BTreeMap::from([
                    ("sum".to_owned(), blob),
                    ("more".to_owned(), blob),
                ]))
            }
            _ => Err(StageError::new("no number is right")
                .cause("numbers")
                .hint("use letters")),
        }
    }
}

/// Appends its input to its earlier output, if it may read that.
pub struct Append(AppendParams);

#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AppendParams {
    pub fixture: FixtureId,
    pub extend: bool,
}

impl Stage for Append {
    fn params(&self) -> serde_json::Value {
        key_params(&self.0, &["fixture"])
    }

    fn work(&self) -> Work<'_> {
        Work::Set(self)
    }

    fn earlier(&self) -> Option<&'static str> {
        self.0.extend.then_some("appended")
    }
}

impl Define for Append {
    type Params = AppendParams;
    const NAME: &'static str = "append";
    const ABOUT: &'static str = "a stage of a test";
    const VERSION: u32 = 1;
    const PORTS: &'static [Port] = &[Port::required("input", "sum")];
    const OUTPUTS: &'static [&'static str] = &["appended"];

    fn new(params: AppendParams) -> Result<Self, ParamError> {
        Ok(Self(params))
    }
}

impl Set for Append {
    fn run(&self, ctx: &Ctx<'_>, inputs: &Inputs) -> Result<Outputs, StageError> {
        let earlier = inputs
            .optional(EARLIER)
            .map(|digest| ctx.get(digest))
            .transpose()?;
        let mut list = earlier.map(|list| list.to_vec()).unwrap_or_default();
        list.extend_from_slice(&ctx.get(inputs.required("sum")?)?);
        list.push(b'\n');
        Ok(BTreeMap::from([("appended".to_owned(), ctx.put(&list)?)]))
    }
}
