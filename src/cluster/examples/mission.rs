//! What the archive of a mission takes on a cluster: a discrete-event simulation from measured unit costs.
//!
//! Prints a row for each site: jobs, requests, bytes, money, CPU and memory of the driver, time, and what was busy how much of it.
//! There is no random number in it: the same table each time. `cargo run --release -p marf-cluster --example mission`
//!
//! Four resources, each first come, first served: the driver (one core), the scheduler of the batch system (a start at a time), the
//! nodes (a job each), and the shared store (its bandwidth is one pipe; a node alone gets no more than its own). All photos are
//! measured, as tasks of arrays; then each scene gets its cameras and goes through rounds of trainings, each round a job a training.

use std::{cmp::Reverse, collections::BinaryHeap};

/// A million of anything.
const MILLION: f64 = 1e6;

/// Unit costs of marf, each with the command that it was measured by; `benches/cluster.md` tells on what.
#[derive(Debug, Clone, Copy)]
struct Costs {
    /// Seconds from the start of a job to its first request. Assumed: the start of a program from a shared file system.
    begin_s: f64,
    /// Seconds of a node to measure a photo for all filters: `marf run --to blur` after a pull, 34 photos of 1280 pixels, two cores.
    measure_s: f64,
    /// Requests of a job beside its photos and the indexes of packs: what `marf exec` of a training prints where its result is there.
    job_gets: f64,
    /// What it prints more where the result is new.
    job_puts: f64,
    /// CPU seconds of the driver for a job of its own: `marf run --on slurm` of a bootstrap with B = 10, 16 s for 11 jobs, what it
    /// computes itself among them: more than a job alone takes.
    driver_job_s: f64,
    /// CPU seconds of the driver for a shard that a task measures: `python3 benches/shards.py MARF DIR 10000`.
    driver_shard_s: f64,
    /// Memory of the driver, bytes: the same with 20 shards, and what each of 10,000 adds.
    driver_bytes: f64,
    driver_shard_bytes: f64,
}

const COSTS: Costs = Costs {
    begin_s: 0.1,
    measure_s: 0.012,
    job_gets: 14.0,
    job_puts: 6.0,
    driver_job_s: 1.5,
    driver_shard_s: 0.0014,
    driver_bytes: 25.0 * MILLION,
    driver_shard_bytes: 16_000.0,
};

/// Dollars, S3 Standard, us-east-1 (aws.amazon.com/s3/pricing, 2025); traffic inside a region is free.
const MILLION_GETS_USD: f64 = 0.40;
const MILLION_PUTS_USD: f64 = 5.0;
const GB_MONTH_USD: f64 = 0.023;

/// What is to be made.
#[derive(Debug, Clone, Copy)]
struct Mission {
    sols: u64,
    photos: u64,
    photo_bytes: f64,
    scenes: u64,
    scene_photos: u64,
    /// Trainings of a scene, round after round: trials, the best again, the field, the members of the bootstrap.
    rounds: &'static [u64],
    /// Seconds of a training on a node.
    train_s: f64,
    /// Seconds for the cameras of a scene, on four cores.
    calibrate_s: f64,
    /// Bytes that a job leaves.
    result_bytes: f64,
}

const MISSION: Mission = Mission {
    sols: 1_300,
    photos: 1_000_000,
    photo_bytes: 0.4 * MILLION,
    scenes: 150,
    scene_photos: 400,
    rounds: &[12, 1, 1, 10],
    train_s: 240.0,
    calibrate_s: 60.0,
    result_bytes: 2.0 * MILLION,
};

/// A batch system, a shared store, and what the site file says.
#[derive(Debug, Clone, Copy)]
struct Site {
    nodes: u64,
    max_jobs: u64,
    photos_per_task: u64,
    starts_per_s: f64,
    /// Bytes a second of the store, and of a node.
    store_rate: f64,
    node_rate: f64,
    poll_s: f64,
    /// Whether `stages` has `calibrate`.
    has_calibrate_jobs: bool,
    /// Whether jobs of a node keep the indexes of packs.
    keeps_indexes: bool,
}

const SITE: Site = Site {
    nodes: 200,
    max_jobs: 200,
    photos_per_task: 1_000,
    starts_per_s: 3.0,
    store_rate: 1_250.0 * MILLION,
    node_rate: 125.0 * MILLION,
    poll_s: 5.0,
    has_calibrate_jobs: true,
    keeps_indexes: true,
};

/// A job: what it reads, how long it computes, and what waits for it.
#[derive(Debug, Clone, Copy)]
struct Job {
    photos: f64,
    read_bytes: f64,
    compute_s: f64,
    driver_s: f64,
    /// The scene that goes on when it is done; none while photos are measured.
    scene: Option<usize>,
}

/// What happens at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Event {
    /// A job may be submitted.
    Ready(usize),
    /// The batch system has a job.
    Queued(usize),
    /// A job has computed its result.
    Computed(usize),
    /// A job has left its node.
    Left(usize),
    /// The driver has a result.
    Brought(usize),
}

/// A resource that serves one after the other.
#[derive(Debug, Clone, Copy, Default)]
struct Server {
    free_at: f64,
    busy_s: f64,
}

impl Server {
    /// Serves for so long from a time on, when it is free; returns when that ends.
    fn serve(&mut self, from: f64, seconds: f64) -> f64 {
        self.free_at = self.free_at.max(from) + seconds;
        self.busy_s += seconds;
        self.free_at
    }
}

/// What it took.
#[derive(Debug, Clone, Copy, Default)]
struct Taken {
    jobs: u64,
    gets: f64,
    puts: f64,
    read_bytes: f64,
    written_bytes: f64,
    end_s: f64,
    driver: Server,
    scheduler: Server,
    store: Server,
    nodes_s: f64,
}

/// A mission under way.
struct Simulation<'a> {
    mission: &'a Mission,
    site: &'a Site,
    costs: &'a Costs,
    /// Time in whole nanoseconds, number, event: ties are served in the order of their numbers.
    events: BinaryHeap<Reverse<(u64, u64, Event)>>,
    numbered: u64,
    now: f64,
    jobs: Vec<Job>,
    /// Those that the batch system has and no node.
    waiting: std::collections::VecDeque<usize>,
    /// Submitted jobs without a result, and those that wait for one of the `max_jobs` places.
    submitted: u64,
    held: std::collections::VecDeque<usize>,
    free_nodes: u64,
    /// Jobs of the photos, and of each scene its round and the jobs in it, that are not done.
    measuring: u64,
    scenes: Vec<(usize, u64)>,
    taken: Taken,
}

impl<'a> Simulation<'a> {
    fn new(mission: &'a Mission, site: &'a Site, costs: &'a Costs) -> Self {
        Self {
            mission,
            site,
            costs,
            events: BinaryHeap::new(),
            numbered: 0,
            now: 0.0,
            jobs: Vec::new(),
            waiting: Default::default(),
            submitted: 0,
            held: Default::default(),
            free_nodes: site.nodes,
            measuring: 0,
            scenes: vec![(0, 0); mission.scenes as usize],
            taken: Taken::default(),
        }
    }

    /// Runs to the end.
    fn run(mut self) -> Taken {
        self.measure();
        while let Some(Reverse((at, _, event))) = self.events.pop() {
            self.now = at as f64 / 1e9;
            match event {
                Event::Ready(job) => self.submit(job),
                Event::Queued(job) => {
                    self.waiting.push_back(job);
                    self.start();
                }
                Event::Computed(job) => self.leave(job),
                Event::Left(job) => self.left(job),
                Event::Brought(job) => self.brought(job),
            }
            self.taken.end_s = self.now;
        }
        self.taken
    }

    fn at(&mut self, seconds: f64, event: Event) {
        self.numbered += 1;
        self.events
            .push(Reverse(((seconds * 1e9).round() as u64, self.numbered, event)));
    }

    fn add(&mut self, job: Job) {
        self.jobs.push(job);
        self.at(self.now, Event::Ready(self.jobs.len() - 1));
    }

    /// Has all photos measured; whole sols, so that there are at most as many tasks as sols.
    fn measure(&mut self) {
        let mission = self.mission;
        let tasks = mission
            .photos
            .div_ceil(self.site.photos_per_task)
            .min(mission.sols);
        let photos = mission.photos as f64 / tasks as f64;
        self.measuring = tasks;
        for _ in 0..tasks {
            self.add(Job {
                photos,
                read_bytes: photos * mission.photo_bytes,
                compute_s: photos * self.costs.measure_s,
                driver_s: self.costs.driver_shard_s * mission.sols as f64 / tasks as f64,
                scene: None,
            });
        }
    }

    /// Begins the next round of a scene; round 0 is its cameras.
    fn go_on(&mut self, scene: usize) {
        let mission = self.mission;
        let photos = mission.scene_photos as f64;
        let job = |compute_s| Job {
            photos,
            read_bytes: photos * mission.photo_bytes,
            compute_s,
            driver_s: self.costs.driver_job_s,
            scene: Some(scene),
        };
        let (round, _) = self.scenes[scene];
        let (number, job) = match round.checked_sub(1) {
            None => (1, job(mission.calibrate_s)),
            Some(round) => match mission.rounds.get(round) {
                Some(number) => (*number, job(mission.train_s)),
                None => return,
            },
        };
        self.scenes[scene] = (round + 1, number);
        if round == 0 && !self.site.has_calibrate_jobs {
            // The driver computes on its one core what a node computes on four.
            self.jobs.push(job);
            let end = self.taken.driver.serve(self.now, 4.0 * mission.calibrate_s);
            self.at(end, Event::Brought(self.jobs.len() - 1));
            self.submitted += 1;
            return;
        }
        (0..number).for_each(|_| self.add(job));
    }

    fn submit(&mut self, job: usize) {
        if self.submitted >= self.site.max_jobs {
            return self.held.push_back(job);
        }
        self.submitted += 1;
        let taken = self.taken.driver.serve(self.now, self.jobs[job].driver_s);
        self.at(taken, Event::Queued(job));
    }

    /// Gives free nodes to jobs that wait.
    fn start(&mut self) {
        while self.free_nodes > 0
            && let Some(number) = self.waiting.pop_front()
        {
            self.free_nodes -= 1;
            let job = self.jobs[number];
            let started = self.taken.scheduler.serve(self.now, 1.0 / self.site.starts_per_s);
            self.taken.jobs += 1;
            self.taken.gets += self.costs.job_gets + job.photos;
            self.taken.gets += self.indexes();
            self.taken.puts += self.costs.job_puts;
            let read = self.transfer(started + self.costs.begin_s, job.read_bytes);
            self.taken.read_bytes += job.read_bytes;
            self.taken.nodes_s += read + job.compute_s - started;
            self.at(read + job.compute_s, Event::Computed(number));
        }
    }

    /// Returns how many indexes of packs a job reads: each job before it has left one.
    fn indexes(&self) -> f64 {
        let packs = self.taken.jobs as f64;
        match self.site.keeps_indexes {
            // Those that came since another job of the same node.
            true => packs.min(self.site.nodes as f64),
            false => packs,
        }
    }

    /// Returns when bytes that are asked for at a time have come.
    fn transfer(&mut self, from: f64, bytes: f64) -> f64 {
        let served = self.taken.store.serve(from, bytes / self.site.store_rate);
        served.max(from + bytes / self.site.node_rate)
    }

    fn leave(&mut self, job: usize) {
        let bytes = self.mission.result_bytes;
        let end = self.transfer(self.now, bytes);
        self.taken.written_bytes += bytes;
        self.taken.nodes_s += end - self.now;
        self.at(end, Event::Left(job));
    }

    fn left(&mut self, job: usize) {
        self.free_nodes += 1;
        self.start();
        // At the latest the next look finds it.
        self.at(self.now + self.site.poll_s, Event::Brought(job));
    }

    fn brought(&mut self, job: usize) {
        self.submitted -= 1;
        if let Some(next) = self.held.pop_front() {
            self.submit(next);
        }
        let Some(scene) = self.jobs[job].scene else {
            self.measuring -= 1;
            if self.measuring == 0 {
                (0..self.scenes.len()).for_each(|scene| self.go_on(scene));
            }
            return;
        };
        self.scenes[scene].1 -= 1;
        if self.scenes[scene].1 == 0 {
            self.go_on(scene);
        }
    }
}

impl Taken {
    fn usd(&self) -> f64 {
        (self.gets * MILLION_GETS_USD + self.puts * MILLION_PUTS_USD) / MILLION
    }

    /// Returns a row of the table.
    fn row(&self, name: &str, mission: &Mission, site: &Site, costs: &Costs) -> String {
        let share = |busy_s: f64| format!("{:.0} %", 100.0 * busy_s / self.end_s);
        let stored = self.written_bytes + mission.photos as f64 * mission.photo_bytes;
        let memory = costs.driver_bytes + costs.driver_shard_bytes * mission.sols as f64;
        let cells = [
            name.to_owned(),
            self.jobs.to_string(),
            format!("{:.2} h", self.end_s / 3600.0),
            share(self.nodes_s / site.nodes as f64),
            share(self.scheduler.busy_s),
            share(self.store.busy_s),
            share(self.driver.busy_s),
            format!("{:.0} s", self.driver.busy_s),
            format!("{:.0} MB", memory / MILLION),
            format!("{:.2} M", self.gets / MILLION),
            format!("{:.3} M", self.puts / MILLION),
            format!("{:.0} GB", (self.read_bytes + self.written_bytes) / 1e9),
            format!("{:.2} $", self.usd()),
            format!("{:.0} $", stored / 1e9 * GB_MONTH_USD),
        ];
        format!("| {} |", cells.join(" | "))
    }
}

/// The sites and missions of the table: one thing turned in each.
fn cases() -> Vec<(&'static str, Mission, Site)> {
    let gpu = Mission {
        train_s: 10.0,
        ..MISSION
    };
    let many = Mission {
        sols: 10_000,
        ..MISSION
    };
    let on_driver = Site {
        has_calibrate_jobs: false,
        ..SITE
    };
    let forgets = Site {
        keeps_indexes: false,
        ..SITE
    };
    let slow = Site {
        store_rate: SITE.node_rate,
        ..SITE
    };
    let small = Site {
        photos_per_task: 100,
        ..SITE
    };
    let large = Site {
        photos_per_task: 20_000,
        ..SITE
    };
    let few = Site {
        max_jobs: 100,
        ..SITE
    };
    let wide = Site {
        nodes: 2_000,
        max_jobs: 2_000,
        ..SITE
    };
    vec![
        ("as above", MISSION, SITE),
        ("`calibrate` on the driver", MISSION, on_driver),
        ("indexes of packs not kept on nodes", MISSION, forgets),
        ("a store of 1 Gbit/s", MISSION, slow),
        ("`photos_per_task = 20000`", MISSION, large),
        ("10,000 sols, `photos_per_task = 100`", many, small),
        ("`max_jobs = 100`, the default", MISSION, few),
        ("2,000 nodes", MISSION, wide),
        ("a GPU a node: 10 s a training", gpu, SITE),
        (
            "the same, 30 starts a second",
            gpu,
            Site {
                starts_per_s: 30.0,
                ..SITE
            },
        ),
    ]
}

#[allow(clippy::print_stdout, reason = "the table is what it is for")]
fn main() {
    println!(
        "| | jobs | time | nodes | scheduler | store | driver | CPU of the driver | memory | GET | PUT | moved | requests | a month |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|");
    for (name, mission, site) in cases() {
        let taken = Simulation::new(&mission, &site, &COSTS).run();
        println!("{}", taken.row(name, &mission, &site, &COSTS));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two photos of 10 bytes in two tasks on one node, then one scene of one photo with a round of one training.
    ///
    /// Submitted at 1 and 2 (a second of the driver each). Task 1 starts at 1 + 2 = 3, begins at 4, has its photo at 5 (10 bytes a
    /// second), measures until 8, leaves at 8.1 (1 byte); its place is free at 8.1. Task 2: start 10.1, begins 11.1, read 12.1,
    /// 15.1, leaves 15.2, is seen at 20.2. Cameras: submitted 21.2, start 23.2, begins 24.2, read 25.2, 29.2, left 29.3, seen 34.3.
    /// Training: submitted 35.3, start 37.3, begins 38.3, read 39.3, 59.3, left 59.4, seen at 64.4.
    #[test]
    fn a_tiny_mission_takes_what_it_takes_by_hand() {
        let mission = Mission {
            sols: 2,
            photos: 2,
            photo_bytes: 10.0,
            scenes: 1,
            scene_photos: 1,
            rounds: &[1],
            train_s: 20.0,
            calibrate_s: 4.0,
            result_bytes: 1.0,
        };
        let site = Site {
            nodes: 1,
            max_jobs: 2,
            photos_per_task: 1,
            starts_per_s: 0.5,
            store_rate: 10.0,
            node_rate: 10.0,
            poll_s: 5.0,
            has_calibrate_jobs: true,
            keeps_indexes: false,
        };
        let costs = Costs {
            begin_s: 1.0,
            measure_s: 3.0,
            job_gets: 2.0,
            job_puts: 3.0,
            driver_job_s: 1.0,
            driver_shard_s: 1.0,
            ..COSTS
        };
        let taken = Simulation::new(&mission, &site, &costs).run();
        assert!((taken.end_s - 64.4).abs() < 1e-6, "{}", taken.end_s);
        assert_eq!(taken.jobs, 4);
        // 2 and a photo each; a job finds the packs of those that started before it, itself among them.
        assert_eq!(
            (taken.gets, taken.puts),
            (4.0 * 3.0 + 1.0 + 2.0 + 3.0 + 4.0, 12.0)
        );
        assert_eq!((taken.read_bytes, taken.written_bytes), (40.0, 4.0));
        assert!((taken.driver.busy_s - 4.0).abs() < 1e-9);
        assert!((taken.scheduler.busy_s - 8.0).abs() < 1e-9);
        assert!((taken.store.busy_s - 4.4).abs() < 1e-9);
        assert!(
            (taken.nodes_s - (2.0 * 5.1 + 6.1 + 22.1)).abs() < 1e-6,
            "{}",
            taken.nodes_s
        );
    }

    #[test]
    fn cameras_on_the_driver_are_made_one_after_the_other() {
        let site = Site {
            has_calibrate_jobs: false,
            ..SITE
        };
        let taken = Simulation::new(&MISSION, &site, &COSTS).run();
        assert!(taken.end_s > 150.0 * 4.0 * MISSION.calibrate_s);
        let jobs = Simulation::new(&MISSION, &SITE, &COSTS).run();
        assert_eq!(jobs.jobs, taken.jobs + 150);
        assert!(jobs.end_s < taken.end_s);
    }
}
