/* SPDX-License-Identifier: Apache-2.0
 *
 * How decisions go from the deciding thread to the publishing thread: rt/core/mailbox.hpp,
 * rt/core/stop_latch.hpp and the order in which rt/control_cycle.cpp and rt/publisher.cpp use them.
 * Every interleaving of CYCLES decisions with a publisher as slow or fast as it likes.
 *
 *   no torn value      what is taken is one cycle's, whole
 *   no stop overtaken  a robot that is permitted as of cycle m hears of no permission of cycle n
 *                      when there was a stop between them, before it hears a stop
 *   no stop undone     no permission goes out that is older than a stop that has been told
 *   no stop lost       once the publisher has looked again, no permission stands that is older than
 *                      the newest stop
 *
 * Spin knows sequential consistency only. What the memory orders are for is in it as variants in
 * which the order is lost. Each of these must be rejected (tests/rt/model/check.py):
 *   INDEX_BEFORE_CONTENT  the index is published before the content is complete (no release)
 *   COPY_AFTER_HANDBACK   the reader's copy ends after the slot is handed back (no acquire)
 *   TWO_SLOTS             a double buffer
 *   NO_LATCH              stops travel in the mailbox alone
 *   LOAD_THEN_STORE       the latch is emptied by a load and a store, not one exchange
 *   LATCH_FIRST           the publisher looks at the latch before the mailbox
 *   SEQUENCE_IGNORED      a withdrawal newer than the report does not keep its pose back
 *   SEQUENCE_FORGOTTEN    it does so only in the run in which it is taken
 */
#ifndef CYCLES
#define CYCLES 5
#endif
#define FRESH 4
#define INDEX 3

typedef Slot { byte first; byte second; bool permitted };  /* two halves: a copy is not atomic */
Slot slots[3];
byte shared = 1;

bool latch_raised;
byte latch_sequence;

/* What really happened; neither thread reads it. */
byte newest_stop;      /* raised completely, or published where there is no latch */
bool stopped[CYCLES + 1];
byte told;             /* the newest cycle of which a stop has been told */
bool robot_is_permitted;
byte robot_cycle;      /* of that permission */
bool writer_is_done;

inline raise(cycle) {
  latch_sequence = cycle;
  latch_raised = true
}

inline publish(cycle, is_permitted) {
#ifdef INDEX_BEFORE_CONTENT
  slots[write].first = cycle;
  atomic { handed = shared; shared = write | FRESH }
  slots[write].second = cycle;
  slots[write].permitted = is_permitted;
  write = handed & INDEX
#else
  slots[write].first = cycle;
  slots[write].second = cycle;
  slots[write].permitted = is_permitted;
  atomic { handed = shared; shared = write | FRESH };
#ifdef TWO_SLOTS
  write = 1 - write
#else
  write = handed & INDEX
#endif
#endif
}

active proctype Deciding() {
  byte write = 0, handed, cycle = 1;
  bool is_permitted;
  do
  :: cycle <= CYCLES ->
    if
    :: is_permitted = true
    :: is_permitted = false
    fi;
    stopped[cycle] = !is_permitted;
#ifndef NO_LATCH
    if
    :: !is_permitted -> raise(cycle)
    :: else
    fi;
#endif
    publish(cycle, is_permitted);
    if
    :: !is_permitted -> newest_stop = cycle
    :: else
    fi;
    cycle++
  :: else -> break
  od;
  writer_is_done = true
}

active proctype Publishing() {
  byte read = 2, handed, copied, reported, sequence, withdrawn_until, k, stop_before;
  bool is_new, is_approved, has_withdrawal, was_done;
  do
  :: true ->
    was_done = writer_is_done;
    stop_before = newest_stop;
    is_new = false;
    has_withdrawal = false;
#ifdef LATCH_FIRST
    atomic { has_withdrawal = latch_raised; latch_raised = false };
    sequence = latch_sequence;
#endif
    if
    :: (shared & FRESH) != 0 ->
#ifdef COPY_AFTER_HANDBACK
      atomic { handed = shared; shared = read; read = handed & INDEX };
      reported = slots[read].first;
      is_approved = slots[read].permitted;
      copied = read;
      atomic {
        if
        :: (shared & FRESH) == 0 -> handed = shared; shared = read; read = handed & INDEX
        :: else
        fi
      };
      assert(slots[copied].second == reported);
#else
#ifdef TWO_SLOTS
      read = shared & INDEX;
      shared = read;
#else
      atomic { handed = shared; shared = read; read = handed & INDEX };
#endif
      reported = slots[read].first;
      is_approved = slots[read].permitted;
      assert(slots[read].second == reported);  /* no torn value */
#endif
      is_new = true
    :: else
    fi;
#ifndef LATCH_FIRST
#ifdef LOAD_THEN_STORE
    has_withdrawal = latch_raised;
    latch_raised = false;
#else
    atomic { has_withdrawal = latch_raised; latch_raised = false };
#endif
    sequence = latch_sequence;
#endif
#ifdef SEQUENCE_FORGOTTEN
    withdrawn_until = 0;
#endif
    if
    :: has_withdrawal && sequence > withdrawn_until -> withdrawn_until = sequence
    :: else
    fi;
    if  /* a withdrawal whose report was overtaken, or is not there yet */
    :: has_withdrawal && (is_approved || !is_new) ->
      atomic {
        robot_is_permitted = false;
        if
        :: sequence > told -> told = sequence
        :: else
        fi
      }
    :: else
    fi;
    if
#ifdef SEQUENCE_IGNORED
    :: is_new && is_approved ->
#else
    :: is_new && is_approved && reported > withdrawn_until ->
#endif
      atomic {
        assert(told < reported);  /* no stop undone */
        k = robot_cycle + 1;
        do
        :: k <= reported -> assert(!stopped[k] || !robot_is_permitted); k++  /* none overtaken */
        :: else -> break
        od;
        robot_is_permitted = true;
        robot_cycle = reported
      }
    :: is_new && !is_approved ->
      atomic {
        robot_is_permitted = false;
        if
        :: reported > told -> told = reported
        :: else
        fi
      }
    :: else
    fi;
    assert(stop_before <= robot_cycle || !robot_is_permitted);  /* no stop lost */
    if
    :: was_done -> break
    :: else
    fi
  od
}
