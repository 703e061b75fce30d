// What the whole process may use of the machine.
#pragma once

namespace horopter {

// Sizes the pool of ParallelFor so that a request and its helpers can use `cores`, and takes
// OpenCV's own threads away: its functions are called inside the loops of the pool, and would start
// threads that no request's budget knows. They leave when the work is to stop (stop_scope.h), at
// the next image or matrix that they take memory for. To be called before the first request.
void SetProcessCores(int cores);

// Freed memory up to the size of an image stays with the process: given back to the system after
// each request and taken again, it costs a request of four VGA images 800 page faults, more
// processor time than all of the service. To be called before threads are started.
void KeepFreedMemory();

}  // namespace horopter
