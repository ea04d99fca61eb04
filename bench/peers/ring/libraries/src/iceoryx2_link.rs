//! iceoryx2 with its own events: variant `blocking` waits at the listener, `waitset` in a set of one.

use iceoryx2::port::{
    listener::Listener, notifier::Notifier, publisher::Publisher, subscriber::Subscriber,
};
use iceoryx2::prelude::*;
use iceoryx2::waitset::WaitSetGuard;

use crate::{Bytes, before};

type Set = (
    &'static WaitSet<ipc::Service>,
    WaitSetGuard<'static, 'static, ipc::Service>,
);

pub struct Link {
    publisher: Publisher<ipc::Service, Bytes, ()>,
    subscriber: Subscriber<ipc::Service, Bytes, ()>,
    notifier: Notifier<ipc::Service>,
    listener: &'static Listener<ipc::Service>,
    set: Option<Set>,
    _node: Node<ipc::Service>,
}

impl Link {
    pub fn open(variant: &str, stage: i32, run: u32) -> Self {
        let mut config = Config::default();
        config.global.prefix = FileName::new(format!("ring{run}_").as_bytes()).unwrap();
        let directory = std::env::temp_dir();
        config
            .global
            .set_root_path(&Path::new(directory.to_str().unwrap().as_bytes()).unwrap());
        let node = NodeBuilder::new()
            .config(&config)
            .create::<ipc::Service>()
            .unwrap();
        let name = |link: i32| ServiceName::new(&format!("link {link}")).unwrap();
        let messages = |link| {
            node.service_builder(&name(link))
                .publish_subscribe::<Bytes>()
                .open_or_create()
                .unwrap()
        };
        let events = |link| {
            node.service_builder(&name(link))
                .event()
                .open_or_create()
                .unwrap()
        };
        // Live until the process ends: the guard of the set borrows them.
        let listener: &'static _ = Box::leak(Box::new(
            events(before(stage)).listener_builder().create().unwrap(),
        ));
        let set = (variant == "waitset").then(|| {
            let set: &'static WaitSet<_> =
                Box::leak(Box::new(WaitSetBuilder::new().create().unwrap()));
            (set, set.attach_notification(listener).unwrap())
        });
        Self {
            publisher: messages(stage).publisher_builder().create().unwrap(),
            subscriber: messages(before(stage))
                .subscriber_builder()
                .create()
                .unwrap(),
            notifier: events(stage).notifier_builder().create().unwrap(),
            listener,
            set,
            _node: node,
        }
    }

    pub fn send(&self, message: &Bytes) {
        let sample = self.publisher.loan_uninit().unwrap();
        sample.write_payload(*message).send().unwrap();
        self.notifier.notify().unwrap();
    }

    pub fn receive(&self) -> Bytes {
        loop {
            match &self.set {
                None => drop(self.listener.blocking_wait(|_| {}).unwrap()),
                Some((set, guard)) => {
                    let ready = |id: WaitSetAttachmentId<_>| {
                        if id.has_event_from(guard) {
                            self.listener.try_wait(|_| {}).unwrap();
                        }
                        CallbackProgression::Continue
                    };
                    set.wait_and_process_once(ready).unwrap();
                }
            }
            if let Some(sample) = self.subscriber.receive().unwrap() {
                return *sample.payload();
            }
        }
    }
}
