// Ctrl-C as a flag: a command ends in good order and keeps what it has.
#pragma once

namespace horopter {

// From now on the first SIGINT or SIGTERM only sets the flag; a second one ends the program as
// usual. Once, before threads start.
void CatchInterrupts();

bool Interrupted();

}  // namespace horopter
