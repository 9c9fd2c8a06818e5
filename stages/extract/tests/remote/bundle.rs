//! A PDS4 bundle that grows in three states: what its pages list is what a run has.

use md5::{Digest as _, Md5};

use super::*;

const COLLECTION: &str = "/img/data/mars2020/mars2020_navcam_ops_raw/data";
/// Bytes before the pixels.
const HEADER: usize = 512;
/// Side of the picture, pixels.
const SIDE: usize = 8;

/// A version of a product of the collection.
#[derive(Clone, Copy, PartialEq)]
pub(super) struct Version {
    sol: u32,
    number: u32,
    version: u32,
}

impl Version {
    pub fn new(sol: u32, number: u32, version: u32) -> Self {
        Self { sol, number, version }
    }

    /// Name without version: the last part of the identifier in upper case.
    fn product(self) -> String {
        let Self { sol, number, .. } = self;
        format!("NLM_{sol:04}_0667{number:06}_000EDR_N0030000NCAM00500_00_0LLJ")
    }

    pub fn name(self) -> String {
        format!("{}{:02}", self.product(), self.version)
    }

    pub fn path(self, end: &str) -> String {
        format!(
            "{COLLECTION}/sol/{:05}/ids/edr/ncam/{}.{end}",
            self.sol,
            self.name()
        )
    }

    pub fn pixels(self) -> Vec<u8> {
        let mut bytes = vec![b' '; HEADER];
        let sample = |at: u32| ((at * 37 + self.number * 11 + self.version * 5) % 4_000) as u16;
        bytes.extend((0..(SIDE * SIDE) as u32).flat_map(|at| sample(at).to_be_bytes()));
        bytes
    }

    /// Its label, with size and checksum of the file.
    pub fn label(self) -> String {
        let pixels = self.pixels();
        let md5: String = Md5::digest(&pixels)
            .iter()
            .map(|byte| format!("{byte:02X}"))
            .collect();
        let lid = self.product().to_ascii_lowercase();
        let axis = |number: u32, name: &str| {
            format!(
                "<Axis_Array><axis_name>{name}</axis_name><elements>{SIDE}</elements>\
                 <sequence_number>{number}</sequence_number></Axis_Array>"
            )
        };
        format!(
            "<?xml version=\"1.0\"?>
<Product_Observational xmlns=\"http://pds.nasa.gov/pds4/pds/v1\" xmlns:m=\"http://pds.nasa.gov/pds4/mission/mars2020/v1\">
 <Identification_Area><logical_identifier>urn:nasa:pds:mars2020_navcam_ops_raw:data:{lid}</logical_identifier>
 <version_id>{version}.0</version_id></Identification_Area>
 <Observation_Area>
  <Observing_System><Observing_System_Component><name>Navigation Camera Left</name><type>Instrument</type>
  </Observing_System_Component></Observing_System>
  <Mission_Area><m:Mars2020_Parameters><m:Observation_Information><m:sol_number>{sol}</m:sol_number>
  </m:Observation_Information></m:Mars2020_Parameters></Mission_Area>
 </Observation_Area>
 <File_Area_Observational><File><file_name>{name}.IMG</file_name><file_size unit=\"byte\">{size}</file_size>
  <md5_checksum>{md5}</md5_checksum></File>
  <Array_2D_Image><offset unit=\"byte\">{HEADER}</offset><axes>2</axes>
  <axis_index_order>Last Index Fastest</axis_index_order>
  <Element_Array><data_type>SignedMSB2</data_type></Element_Array>{line}{sample}</Array_2D_Image>
 </File_Area_Observational>
</Product_Observational>
",
            version = self.version,
            sol = self.sol,
            name = self.name(),
            size = pixels.len(),
            line = axis(1, "Line"),
            sample = axis(2, "Sample"),
        )
    }
}

/// Adds these products to the collection. It has no inventory: a page with one and an old date is not asked for again.
pub(super) fn release(server: &Server, files: &[Version]) {
    for version in files {
        server.file(&version.path("IMG"), version.pixels());
        server.file(&version.path("xml"), version.label());
    }
}

pub(super) fn archive(place: &Place, server: &Server) -> Archive {
    let archive = with(place.archive(server, "1..=9"), "/instrument", json!("navcam"));
    with(archive, "/pixels", json!("img"))
}

fn files(server: &Server) -> BTreeSet<String> {
    let requests = server.requests();
    requests
        .iter()
        .map(|one| one.path().to_owned())
        .filter(|path| path.contains("/ids/") && !path.ends_with('/'))
        .collect()
}

fn names(versions: &[Version]) -> Vec<String> {
    versions.iter().map(|version| version.name()).collect()
}

#[test]
fn a_bundle_that_grows_supersedes_and_withdraws_is_followed() {
    let server = Server::start().unwrap();
    let [a, b, c, d] = [(1, 1), (1, 2), (2, 3), (3, 4)].map(|(sol, number)| Version::new(sol, number, 1));
    let b2 = Version { version: 2, ..b };
    let place = Place::new();
    let archive = archive(&place, &server);

    release(&server, &[a, b, c]);
    let first = place.bring(&archive).unwrap();
    assert_eq!(first.rows.keys().cloned().collect::<Vec<_>>(), names(&[a, b, c]));
    assert_eq!(first.facts[&a.name()]["width"], SIDE);

    // A product is replaced and one is added. The pages list both versions.
    release(&server, &[b2, d]);
    server.clear();
    let second = place.bring(&archive).unwrap();
    assert_eq!(
        second.rows.keys().cloned().collect::<Vec<_>>(),
        names(&[a, b2, c, d])
    );
    assert_eq!(second.reason(&b.name()), "version 01 is superseded by 02");
    let new = [b2, d].map(|version| ["IMG", "xml"].map(|end| version.path(end)));
    assert_eq!(files(&server), new.into_iter().flatten().collect());
    assert_eq!(
        [&second.rows[&a.name()], &second.rows[&c.name()]],
        [&first.rows[&a.name()], &first.rows[&c.name()]]
    );

    // The only product of a sol is withdrawn, and the superseded version is listed no more.
    [c, b].iter().for_each(|version| {
        ["IMG", "xml"]
            .iter()
            .for_each(|end| server.remove(&version.path(end)))
    });
    server.clear();
    let third = place.bring(&archive).unwrap();
    assert_eq!(third.rows.keys().cloned().collect::<Vec<_>>(), names(&[a, b2, d]));
    assert_eq!(third.reason(&c.name()), "the archive lists it no longer");
    assert_eq!(third.reason(&b.name()), "version 01 is superseded by 02");
    assert_eq!(files(&server), BTreeSet::new(), "nothing is fetched");

    server.clear();
    let again = place.bring(&archive).unwrap();
    assert_eq!((&again.listing, &again.rows), (&third.listing, &third.rows));
    assert_eq!(again.verdicts, third.verdicts);
    assert_eq!(files(&server), BTreeSet::new(), "nothing is fetched again");
    let offline = place.bring(&access(&archive, Access::Offline)).unwrap();
    assert_eq!(
        (&offline.listing, &offline.verdicts),
        (&third.listing, &third.verdicts)
    );

    // What is withdrawn may come back.
    release(&server, &[c]);
    assert_eq!(place.bring(&archive).unwrap().rows, second.rows);
}

/// A folder page shows no product of a sol any more, or no folder of it.
#[test]
fn a_sol_of_which_nothing_is_listed_any_more_is_reported() {
    let server = Server::start().unwrap();
    let [a, b] = [Version::new(1, 1, 1), Version::new(2, 2, 1)];
    release(&server, &[a, b]);
    let place = Place::new();
    let archive = archive(&place, &server);
    place.bring(&archive).unwrap();
    for folder in [false, true] {
        ["IMG", "xml"].iter().for_each(|end| server.remove(&b.path(end)));
        if folder {
            server.folder(&format!("{COLLECTION}/sol/00002/ids/edr/ncam/"));
        }
        let brought = place.bring(&archive).unwrap();
        assert_eq!(brought.rows.keys().cloned().collect::<Vec<_>>(), names(&[a]));
        assert_eq!(
            brought.reason(&b.name()),
            "the archive lists it no longer",
            "folder: {folder}"
        );
    }
}
