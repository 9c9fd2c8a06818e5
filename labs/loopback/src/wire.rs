//! Sockets: a request is read, its answer sent or spoilt.

use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use super::answer::Answer;
use super::{Reply, Request, Shared, hash};

/// How long a broken connection stays open, so that what was sent is read before the break.
const BEFORE_BREAK: Duration = Duration::from_millis(20);

/// Counts an answer in progress. It ends before its last byte leaves, so that the next request never overlaps
/// it.
struct Busy<'a>(Option<&'a Shared>);

impl Busy<'_> {
    fn end(&mut self) {
        if let Some(shared) = self.0.take() {
            shared.at_once.fetch_sub(1, Ordering::SeqCst);
        }
    }
}

impl Drop for Busy<'_> {
    fn drop(&mut self) {
        self.end();
    }
}

impl Shared {
    /// Answers one request. False ends the connection.
    pub(super) fn serve(&self, stream: &TcpStream) -> std::io::Result<bool> {
        let Some((head, length)) = self.read_head(stream)? else {
            return Ok(false);
        };
        let now = self.at_once.fetch_add(1, Ordering::SeqCst) + 1;
        self.most_at_once.fetch_max(now, Ordering::SeqCst);
        let busy = Busy(Some(self));
        let request = parse(&head);
        let reply = self.reply_to(&request);
        // A close with a byte unread is a reset.
        let unread = usize::from(matches!(reply, Reply::Reset { .. }));
        let (mut sink, mut source) = (vec![0; length - unread], stream);
        source.read_exact(&mut sink)?;
        self.send(stream, &request, &reply, busy)
    }

    /// Looks at a request's head without taking it.
    fn read_head(&self, stream: &TcpStream) -> std::io::Result<Option<(String, usize)>> {
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(Duration::from_millis(100)))?;
        let mut buffer = vec![0; 64 << 10];
        while !self.stop.load(Ordering::SeqCst) {
            match stream.peek(&mut buffer) {
                Ok(0) => return Ok(None),
                Ok(count) => {
                    let text = String::from_utf8_lossy(&buffer[..count]).into_owned();
                    if let Some(end) = text.find("\r\n\r\n") {
                        return Ok(Some((text[..end].to_owned(), end + 4)));
                    }
                    std::thread::sleep(Duration::from_millis(1));
                }
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(None)
    }

    /// Records the request and takes its reply: of its script, a random fault, or the normal answer.
    fn reply_to(&self, request: &Request) -> Reply {
        let mut state = self.state.lock();
        state.requests.push(request.clone());
        let asked = state.asked.entry(request.path().to_owned()).or_default();
        *asked += 1;
        let asked = *asked;
        for key in [request.target.as_str(), request.path()] {
            let Some(script) = state.scripts.get_mut(key) else {
                continue;
            };
            if let Some(Reply::Always(reply)) = script.front() {
                return (**reply).clone();
            }
            if let Some(reply) = script.pop_front() {
                return reply;
            }
        }
        match state.faults {
            Some((seed, share)) => fault(seed, share, request.path(), asked),
            None => Reply::Normal,
        }
    }

    fn send(
        &self,
        stream: &TcpStream,
        request: &Request,
        reply: &Reply,
        mut busy: Busy<'_>,
    ) -> std::io::Result<bool> {
        let answer = match reply {
            Reply::Status(status, headers, body) => Answer {
                headers: headers.clone(),
                ..Answer::new(*status, body.clone())
            },
            Reply::Endless => Answer {
                status: 200,
                ..self.normal(request, reply)
            },
            Reply::Redirect(to) => Answer::new(302, b"moved".to_vec()).header("Location", to),
            other => self.normal(request, other),
        };
        let (length, mut out) = (answer.body.len(), stream);
        let announced = length as i64;
        let upto = |after: usize| &answer.body[..after.min(length)];
        match reply {
            Reply::Silent => self.silence(stream),
            Reply::Stall { after } => {
                out.write_all(&[&answer.head(Some(announced)), upto(*after)].concat())?;
                self.silence(stream);
            }
            Reply::Reset { after } | Reply::Cut { after } => {
                out.write_all(&[&answer.head(Some(announced)), upto(*after)].concat())?;
                self.wait(BEFORE_BREAK);
            }
            Reply::Announce { more } => {
                busy.end();
                out.write_all(&[&answer.head(Some((announced + more).max(0))), &answer.body[..]].concat())?;
                self.wait(BEFORE_BREAK);
            }
            Reply::Endless => {
                out.write_all(&answer.head(None))?;
                while !self.stop.load(Ordering::SeqCst) {
                    out.write_all(&[b"1000\r\n", &[b'x'; 0x1000][..], b"\r\n"].concat())?;
                }
            }
            Reply::Drip { bytes, every } => {
                out.write_all(&answer.head(Some(announced)))?;
                let mut pieces = answer.body.chunks((*bytes).max(1));
                let last = pieces.next_back().unwrap_or_default();
                for piece in pieces {
                    out.write_all(piece)?;
                    self.wait(*every);
                }
                busy.end();
                out.write_all(last)?;
                return Ok(true);
            }
            _ => {
                let all = [&answer.head(Some(announced))[..], &answer.body].concat();
                let (most, last) = all.split_at(all.len().saturating_sub(1));
                out.write_all(most)?;
                busy.end();
                out.write_all(last)?;
                return Ok(true);
            }
        }
        busy.end();
        Ok(false)
    }

    /// Sleeps, but not past the end of the server.
    fn wait(&self, time: Duration) {
        let began = Instant::now();
        while began.elapsed() < time && !self.stop.load(Ordering::SeqCst) {
            let left = time.saturating_sub(began.elapsed());
            std::thread::sleep(left.min(Duration::from_millis(20)));
        }
    }

    /// Says nothing until the client goes.
    fn silence(&self, stream: &TcpStream) {
        while !self.stop.load(Ordering::SeqCst) {
            match stream.peek(&mut [0]) {
                Ok(0) => return,
                Ok(_) => self.wait(BEFORE_BREAK),
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
                Err(_) => return,
            }
        }
    }
}

fn parse(head: &str) -> Request {
    let mut lines = head.split("\r\n");
    let mut words = lines.next().unwrap_or_default().split(' ');
    let mut word = || words.next().unwrap_or_default().to_owned();
    let header = |line: &str| {
        let (name, value) = line.split_once(':')?;
        Some((name.to_ascii_lowercase(), value.trim().to_owned()))
    };
    Request {
        method: word(),
        target: word(),
        headers: lines.filter_map(header).collect(),
        at: Instant::now(),
    }
}

/// The fault of the `asked`-th request of a path, if its turn has come.
fn fault(seed: u64, share: f64, path: &str, asked: u64) -> Reply {
    let draw = hash(&[&seed.to_le_bytes(), path.as_bytes(), &asked.to_le_bytes()]);
    if (draw >> 11) as f64 / (1_u64 << 53) as f64 >= share {
        return Reply::Normal;
    }
    match hash(&[&draw.to_le_bytes()]) % 7 {
        0 => Reply::status(503),
        1 => Reply::with(429, "Retry-After", "0"),
        2 => Reply::status(500),
        3 => Reply::Reset { after: 700 },
        4 => Reply::Cut { after: 900 },
        5 => Reply::Announce { more: 10 },
        _ => Reply::Silent,
    }
}
