/* The C interface of motiongen, for game engines. Compiles as C99 and as C++.
 *
 * Every struct begins with struct_size, which the caller sets to the struct's sizeof, so that structs can grow: fields
 * beyond that size are unknown to the caller; they are read as 0 and never written. A struct_size of 0 is refused,
 * except in `error`, into which nothing is written then. In options, 0 and NULL leave the choice to the library or the
 * server. Functions that can fail return a motiongen_code and, where `error` is not NULL, write there what was given
 * and what is allowed. Texts must be UTF-8; others are refused. Frames count from 0 at the start of a session. Axes and
 * units are those of docs/motion.md: right-handed, +Y up, +Z forward, metres, radians, quaternions w x y z. Any
 * function may be called from any thread; a handle must not be used during or after its destruction. */
#ifndef MOTIONGEN_MOTIONGEN_H_
#define MOTIONGEN_MOTIONGEN_H_

#include "motiongen/c/client.h"  /* IWYU pragma: export */
#include "motiongen/c/engines.h" /* IWYU pragma: export */
#include "motiongen/c/ground.h"  /* IWYU pragma: export */
#include "motiongen/c/session.h" /* IWYU pragma: export */
#include "motiongen/c/structs.h" /* IWYU pragma: export */

#endif /* MOTIONGEN_MOTIONGEN_H_ */
