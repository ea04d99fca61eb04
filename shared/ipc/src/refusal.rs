//! Why the middleware opened no service: whether it passes, and whether another build is in the way.
//!
//! The middleware has an error type per kind of service. Here they are one.

use iceoryx2::service::builder::blackboard::{BlackboardCreateError, BlackboardOpenError};
use iceoryx2::service::builder::publish_subscribe::{
    PublishSubscribeCreateError, PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError,
};
use iceoryx2::service::builder::request_response::{
    RequestResponseCreateError, RequestResponseOpenError, RequestResponseOpenOrCreateError,
};

/// What the middleware said, and what follows from it.
#[derive(Debug)]
pub(crate) struct Refusal {
    pub(crate) kind: RefusalKind,
    pub(crate) reason: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RefusalKind {
    /// Another process is just making the service or taking it down, or a signal came: soon it is another matter.
    Passing,
    Differs,
    Lasting,
}

macro_rules! refusal {
    ($($error:ident: passing { $($passing:ident),+ } differs { $($differs:ident),* })+) => {
        $(impl From<$error> for Refusal {
            fn from(error: $error) -> Self {
                let kind = match error {
                    $($error::$passing)|+ => RefusalKind::Passing,
                    $($error::$differs => RefusalKind::Differs,)*
                    _ => RefusalKind::Lasting,
                };
                Self { kind, reason: format!("{error:?}") }
            }
        })+
    };
}

refusal! {
    PublishSubscribeOpenError:
        passing { Interrupt, DoesNotExist, ServiceInCorruptedState, HangsInCreation, IsMarkedForDestruction }
        differs {
            IncompatibleTypes,
            IncompatibleMessagingPattern,
            IncompatibleAttributes,
            IncompatibleOverflowBehavior,
            DoesNotSupportRequestedMinBufferSize,
            DoesNotSupportRequestedMinHistorySize,
            DoesNotSupportRequestedMinSubscriberBorrowedSamples,
            DoesNotSupportRequestedAmountOfPublishers,
            DoesNotSupportRequestedAmountOfSubscribers,
            DoesNotSupportRequestedAmountOfNodes,
            VersionMismatch
        }
    PublishSubscribeCreateError:
        passing { Interrupt, ServiceInCorruptedState, HangsInCreation, IsBeingCreatedByAnotherInstance }
        differs {}
    RequestResponseOpenError:
        passing { Interrupt, DoesNotExist, ServiceInCorruptedState, HangsInCreation, IsMarkedForDestruction }
        differs {
            IncompatibleRequestOrResponseType,
            IncompatibleMessagingPattern,
            IncompatibleAttributes,
            IncompatibleOverflowBehaviorForRequests,
            IncompatibleOverflowBehaviorForResponses,
            IncompatibleBehaviorForFireAndForgetRequests,
            DoesNotSupportRequestedAmountOfClientRequestLoans,
            DoesNotSupportRequestedAmountOfActiveRequestsPerClient,
            DoesNotSupportRequestedResponseBufferSize,
            DoesNotSupportRequestedAmountOfServers,
            DoesNotSupportRequestedAmountOfClients,
            DoesNotSupportRequestedAmountOfNodes,
            DoesNotSupportRequestedAmountOfBorrowedResponsesPerPendingResponse,
            VersionMismatch
        }
    RequestResponseCreateError:
        passing { Interrupt, ServiceInCorruptedState, HangsInCreation, IsBeingCreatedByAnotherInstance }
        differs {}
    BlackboardOpenError:
        passing { Interrupt, DoesNotExist, ServiceInCorruptedState, HangsInCreation, IsMarkedForDestruction }
        differs {
            IncompatibleKeys,
            IncompatibleMessagingPattern,
            IncompatibleAttributes,
            DoesNotSupportRequestedAmountOfReaders,
            DoesNotSupportRequestedAmountOfNodes,
            VersionMismatch
        }
    BlackboardCreateError:
        passing { Interrupt, ServiceInCorruptedState, HangsInCreation, IsBeingCreatedByAnotherInstance }
        differs {}
}

impl Refusal {
    /// Others make and remove the service all the time.
    fn in_flux(error: impl std::fmt::Debug) -> Self {
        Self {
            kind: RefusalKind::Passing,
            reason: format!("{error:?}"),
        }
    }
}

impl From<PublishSubscribeOpenOrCreateError> for Refusal {
    fn from(error: PublishSubscribeOpenOrCreateError) -> Self {
        match error {
            PublishSubscribeOpenOrCreateError::PublishSubscribeOpenError(error) => error.into(),
            PublishSubscribeOpenOrCreateError::PublishSubscribeCreateError(error) => error.into(),
            PublishSubscribeOpenOrCreateError::SystemInFlux => Self::in_flux(error),
        }
    }
}

impl From<RequestResponseOpenOrCreateError> for Refusal {
    fn from(error: RequestResponseOpenOrCreateError) -> Self {
        match error {
            RequestResponseOpenOrCreateError::RequestResponseOpenError(error) => error.into(),
            RequestResponseOpenOrCreateError::RequestResponseCreateError(error) => error.into(),
            RequestResponseOpenOrCreateError::SystemInFlux => Self::in_flux(error),
        }
    }
}
