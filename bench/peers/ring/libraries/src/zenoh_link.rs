//! zenoh: variant `unix` or `tcp` between processes, or `shared-memory` (announced over a unix socket).

use zenoh::handlers::FifoChannelHandler;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::Sample;
use zenoh::shm::{
    BlockOn, GarbageCollect, PosixShmProviderBackend, ShmProvider, ShmProviderBuilder,
};
use zenoh::{Config, Session, Wait};

use crate::{BYTES, Bytes, STAGES, before};

pub struct Link {
    publisher: Publisher<'static>,
    subscriber: Subscriber<FifoChannelHandler<Sample>>,
    provider: Option<ShmProvider<PosixShmProviderBackend>>,
    session: Session,
}

impl Link {
    pub fn open(variant: &str, stage: i32, run: u32) -> Self {
        let directory = std::env::temp_dir();
        let endpoint = |link: i32| match variant {
            "tcp" => format!(
                "tcp/127.0.0.1:{}",
                20_000 + (run * STAGES as u32 + link as u32) % 40_000
            ),
            _ => format!("unixsock-stream/{}/ring-{run}-{link}", directory.display()),
        };
        let is_shared = variant == "shared-memory";
        let mut config = Config::default();
        for (key, value) in [
            ("mode", r#""peer""#.to_owned()),
            ("scouting/multicast/enabled", "false".into()),
            ("scouting/gossip/enabled", "false".into()),
            ("listen/endpoints", format!(r#"["{}"]"#, endpoint(stage))),
            (
                "connect/endpoints",
                format!(r#"["{}"]"#, endpoint(before(stage))),
            ),
            ("connect/timeout_ms", "10000".into()),
            (
                "connect/retry",
                "{period_init_ms: 50, period_max_ms: 50, period_increase_factor: 1}".into(),
            ),
            ("transport/shared_memory/enabled", is_shared.to_string()),
        ] {
            config.insert_json5(key, &value).unwrap();
        }
        let session = zenoh::open(config).wait().unwrap();
        let publisher = session
            .declare_publisher(format!("ring/{stage}"))
            .express(true);
        let publisher = publisher
            .priority(Priority::RealTime)
            .congestion_control(CongestionControl::Block);
        Self {
            publisher: publisher.wait().unwrap(),
            subscriber: session
                .declare_subscriber(format!("ring/{}", before(stage)))
                .wait()
                .unwrap(),
            provider: is_shared
                .then(|| ShmProviderBuilder::default_backend(1 << 16).wait().unwrap()),
            session,
        }
    }

    pub fn send(&self, message: &Bytes) {
        let sent = match &self.provider {
            None => self.publisher.put(message.as_slice()).wait(),
            Some(provider) => {
                let mut buffer = provider
                    .alloc(BYTES)
                    .with_policy::<BlockOn<GarbageCollect>>()
                    .wait()
                    .unwrap();
                buffer.copy_from_slice(message);
                self.publisher.put(buffer).wait()
            }
        };
        sent.unwrap();
    }

    pub fn receive(&self) -> Bytes {
        let sample = self.subscriber.recv().unwrap();
        sample
            .payload()
            .to_bytes()
            .as_ref()
            .try_into()
            .expect("a message of another size")
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.session.close().wait().unwrap();
    }
}
