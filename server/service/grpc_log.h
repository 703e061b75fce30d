// What gRPC itself says, in our log.
#pragma once

namespace horopter {

// From now on gRPC's messages are lines of this process's log, few of a kind in a while: what
// breaks off or is refused on the wire is a client's doing and can come by the thousand.
void LogGrpcMessages();

}  // namespace horopter
