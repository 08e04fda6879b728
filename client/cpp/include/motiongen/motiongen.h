/* motiongen for engines: a C interface whose structs may grow. Compiles as C99 and as C++.
 *
 * Every struct begins with struct_size, which the caller sets to its sizeof; what lies beyond it was not known to the
 * caller, is taken as 0 and is not written. One of 0 is refused, but for `error`, into which nothing is written then.
 * In options 0 and NULL leave a choice to the library or to the server. Functions that can fail return a motiongen_code
 * and, where `error` is not NULL, say there what was given and what is allowed. Texts are UTF-8; others are refused.
 * Frames count from 0 at the start of a session; axes and units are those of docs/motion.md: right-handed, +Y up, +Z
 * forward, metres, radians, quaternions w x y z. Any function may be called from any thread; a handle must not be used
 * while it is destroyed, nor after. */
#ifndef MOTIONGEN_MOTIONGEN_H_
#define MOTIONGEN_MOTIONGEN_H_

#include "motiongen/c/client.h"  /* IWYU pragma: export */
#include "motiongen/c/engines.h" /* IWYU pragma: export */
#include "motiongen/c/ground.h"  /* IWYU pragma: export */
#include "motiongen/c/session.h" /* IWYU pragma: export */
#include "motiongen/c/structs.h" /* IWYU pragma: export */

#endif /* MOTIONGEN_MOTIONGEN_H_ */
