//! The tree of Curiosity's Navcam: a folder a sol, raw products, each label in a file of its own.

use super::*;

const VOLUME: &str = "/img/data/msl/MSLNAV_0XXX";
/// Side of the picture, pixels.
const SIDE: usize = 16;
/// Records before the pixels: two headers, of which none is read here.
const HEADER_RECORDS: usize = 22;

/// A raw product as the archive has it.
pub(super) struct Edr {
    /// Folder and name without extension.
    pub path: String,
    pub label: String,
    pub pixels: Vec<u8>,
}

impl Edr {
    /// `kind` is `F` of a full frame, `T` of a thumbnail.
    pub fn new(sol: u32, clock: u32, kind: char) -> Self {
        let name = format!("NLB_{clock:09}EDR_{kind}0540992NCAM00295M1");
        Self {
            label: label(&name, sol),
            pixels: pixels(clock),
            path: format!("DATA/SOL{sol:05}/{name}"),
        }
    }

    pub fn name(&self) -> &str {
        self.path.rsplit('/').next().unwrap()
    }

    /// Puts it on a server, as changed on this day of March 2022.
    pub fn mount(&self, server: &Server, day: u32) {
        let modified = format!("Tue, {day:02} Mar 2022 10:20:00 GMT");
        for (end, bytes) in [("LBL", self.label.as_bytes()), ("IMG", &self.pixels)] {
            let (path, etag) = (
                format!("{VOLUME}/{}.{end}", self.path),
                format!("\"{}-{day}\"", self.name()),
            );
            server.file_with(&path, bytes, Some(&etag), Some(&modified));
        }
    }
}

/// Big-endian samples of 12 bits behind headers.
fn pixels(clock: u32) -> Vec<u8> {
    let mut bytes = vec![0; HEADER_RECORDS * SIDE * 2];
    let sample = |at: u32| ((at * 97 + clock % 1_000 * 31) % 4_000 + 50) as u16;
    bytes.extend((0..(SIDE * SIDE) as u32).flat_map(|at| sample(at).to_be_bytes()));
    bytes
}

/// `LINES` comes three times: requested, of the thumbnail, and of the image.
fn label(name: &str, sol: u32) -> String {
    let half = SIDE / 2;
    let lines = format!(
        "PDS_VERSION_ID = PDS3
RECORD_TYPE = FIXED_LENGTH
RECORD_BYTES = {record}
FILE_RECORDS = {records}
^IMAGE_HEADER = (\"{name}.IMG\",15)
^IMAGE = (\"{name}.IMG\"
          ,{first})
INSTRUMENT_HOST_ID = \"MSL\"
INSTRUMENT_ID = \"NAV_LEFT_B\"
IMAGE_TYPE = REGULAR
PLANET_DAY_NUMBER = {sol}
PRODUCT_ID = \"{name}\"
ROVER_MOTION_COUNTER = (54,992,12,14,0,0,72,54,0,0)
ROVER_MOTION_COUNTER_NAME = (\"SITE\",\"DRIVE\",\"POSE\",\"ARM\",\"CHIMRA\",
                             \"DRILL\",\"RSM\",\"HGA\",\"DRT\",\"IC\")
GROUP = GEOMETRIC_CAMERA_MODEL_PARMS
  MODEL_TYPE = CAHVOR
  MODEL_COMPONENT_ID = (\"C\",\"A\",\"H\",\"V\",\"O\",\"R\")
  MODEL_COMPONENT_1 = (1.0,0.66,-1.85)
  MODEL_COMPONENT_2 = (1.0,0.0,0.0)
  MODEL_COMPONENT_3 = ({half}.0,20.0,0.0)
  MODEL_COMPONENT_4 = ({half}.0,0.0,20.0)
  MODEL_COMPONENT_5 = (1.0,0.0,0.0)
  MODEL_COMPONENT_6 = (0.0,0.0001,0.006)
  REFERENCE_COORD_SYSTEM_NAME = \"ROVER_NAV_FRAME\"
END_GROUP = GEOMETRIC_CAMERA_MODEL_PARMS
GROUP = ROVER_COORD_SYSTEM_PARMS
  COORDINATE_SYSTEM_NAME = \"ROVER_NAV_FRAME\"
  ORIGIN_OFFSET_VECTOR = (9.5,-9.2,-0.3)
  ORIGIN_ROTATION_QUATERNION = (1.0,0.0,0.0,0.0)
  REFERENCE_COORD_SYSTEM_NAME = \"SITE_FRAME\"
END_GROUP = ROVER_COORD_SYSTEM_PARMS
GROUP = SUBFRAME_REQUEST_PARMS
  LINES = 1024
END_GROUP = SUBFRAME_REQUEST_PARMS
GROUP = THUMBNAIL_REQUEST_PARMS
  LINES = 64
END_GROUP = THUMBNAIL_REQUEST_PARMS
OBJECT = IMAGE
  LINES = {SIDE}
  LINE_SAMPLES = {SIDE}
  SAMPLE_TYPE = MSB_INTEGER
  SAMPLE_BITS = 16
  BANDS = 1
  SAMPLE_BIT_MASK = 2#0000111111111111#
END_OBJECT = IMAGE
END
",
        record = SIDE * 2,
        records = HEADER_RECORDS + SIDE,
        first = HEADER_RECORDS + 1,
    );
    lines.replace('\n', "\r\n")
}

/// Full frames and thumbnails of three sols.
pub(super) fn tree() -> Vec<Edr> {
    let frames = [
        (1_343, 'F'),
        (1_343, 'F'),
        (1_343, 'T'),
        (1_347, 'F'),
        (1_371, 'F'),
    ];
    let numbered = (516_721_703..).zip(frames);
    numbered
        .map(|(clock, (sol, kind))| Edr::new(sol, clock, kind))
        .collect()
}

pub(super) fn archive(place: &Place, server: &Server, sols: &str) -> Archive {
    let archive = with(place.archive(server, sols), "/mission", json!("curiosity"));
    with(archive, "/instrument", json!("navcam"))
}

#[test]
fn a_tree_of_sol_folders_is_crawled_with_detached_labels_and_grows() {
    let server = Server::start().unwrap();
    let tree = tree();
    tree.iter().for_each(|edr| edr.mount(&server, 1));
    server.file(&format!("{VOLUME}/INDEX/INDEX.TAB"), "not read");
    server.file(
        &format!("{VOLUME}/EXTRAS/FULL/SOL01343/{}.JPG", tree[0].name()),
        image_bytes(3),
    );
    let place = Place::new();
    let archive = archive(&place, &server, "1340..=1371");
    let first = place.bring(&archive).unwrap();
    let full = |edr: &&Edr| !edr.name().contains("_T");
    let names: Vec<&str> = tree.iter().filter(full).map(Edr::name).collect();
    assert_eq!(first.rows.keys().collect::<Vec<_>>(), names);
    assert_eq!(first.reason(tree[2].name()), "thumbnail");
    for edr in tree.iter().filter(full) {
        let facts = &first.facts[edr.name()];
        assert_eq!(
            (&facts["width"], &facts["height"]),
            (&json!(SIDE), &json!(SIDE)),
            "{facts}"
        );
        assert_eq!(
            facts["prior"]["motion_counter"][0], 54,
            "its own label gives the camera: {facts}"
        );
        let label = marf_cache::Digest::from_content(edr.label.as_bytes());
        assert!(
            first.rows[edr.name()].contains(&format!("label {label}")),
            "{}",
            first.rows[edr.name()]
        );
    }

    // A sol that is there gets a product, and a new sol comes.
    let new = [
        Edr::new(1_347, 600_000_001, 'F'),
        Edr::new(1_360, 600_000_002, 'F'),
    ];
    new.iter().for_each(|edr| edr.mount(&server, 9));
    server.clear();
    let grown = place.bring(&archive).unwrap();
    assert_eq!(grown.rows.len(), 6);
    assert!(first.rows.iter().all(|(id, row)| grown.rows[id] == *row));
    let asked = server.requests();
    let files: BTreeSet<&str> = asked
        .iter()
        .map(|one| one.path())
        .filter(|path| !path.ends_with('/'))
        .collect();
    let expected: BTreeSet<String> = new
        .iter()
        .flat_map(|edr| ["LBL", "IMG"].map(|end| format!("{VOLUME}/{}.{end}", edr.path)))
        .collect();
    assert_eq!(files, expected.iter().map(String::as_str).collect());
    server.clear();
    assert_eq!(place.bring(&archive).unwrap().rows, grown.rows);
    let asked: Vec<String> = server
        .requests()
        .iter()
        .map(|one| one.path().to_owned())
        .collect();
    assert_eq!(asked.len(), 3, "the bundle, the volumes and the sols: {asked:?}");
}

#[test]
fn a_local_copy_of_the_tree_gives_the_same_photos() {
    let (server, place, dir) = (
        Server::start().unwrap(),
        Place::new(),
        tempfile::tempdir().unwrap(),
    );
    for edr in tree() {
        edr.mount(&server, 1);
        for (end, bytes) in [("LBL", edr.label.as_bytes()), ("IMG", &edr.pixels)] {
            let path = dir.path().join(format!("{}.{end}", edr.path));
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, bytes).unwrap();
        }
    }
    let remote = place.bring(&archive(&place, &server, "1340..=1371")).unwrap();
    let local = common::bring(common::folder(dir.path())).unwrap();
    for (sol, row) in &local.rows {
        if row.facts["thumbnail"] == true {
            continue;
        }
        let theirs = &remote.facts[&row.id];
        for key in ["width", "prior", "sol", "instrument", "sensor"] {
            assert_eq!(row.facts[key], theirs[key], "{} {key}", row.id);
        }
        assert_eq!(theirs["sol"], *sol);
        assert!(
            remote.rows[&row.id].contains(&row.blobs["image"].to_string()),
            "{}",
            row.id
        );
    }
    assert_eq!(
        local.rows.len(),
        tree().len(),
        "with the thumbnail, which a filter rejects"
    );
}
