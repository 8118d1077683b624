"""Clusters: what is sent, kept and told."""

from tests.mutation.change import Change

DISPATCH = "sysid_evo/plan/dask_executor.py"
REMOTE = "sysid_evo/plan/dask_worker.py"
SCHEDULER = "sysid_evo/plan/dask_executor.py"
PARCELS = "sysid_evo/plan/store.py"
CLUSTER = "sysid_evo/plan/dask_executor.py"
TEST_DISPATCH = "tests/sysid_evo/plan/test_dispatch.py"
TEST_REMOTE = "tests/sysid_evo/plan/test_remote.py"
TEST_SCHEDULER = "tests/sysid_evo/plan/test_scheduler.py"
TEST_PARCELS = "tests/sysid_evo/plan/test_parcels.py"
TEST_WHAT_IS_LOST = "tests/sysid_evo/plan/test_what_is_lost.py"

CHANGES = (
    Change(
        "every parcel is let go of",
        DISPATCH,
        "kept = {name for name in (*needed, *self._made_of) if self._is_there(name)}",
        "kept = {name for name in needed if self._is_there(name)}",
        (TEST_DISPATCH,),
    ),
    Change("no parcel is let go of", DISPATCH, "if name in kept}", "}", (TEST_DISPATCH,)),
    Change(
        "what the plan is made of is not sent again",
        DISPATCH,
        "for name in (*needed, *self._made_of):\n            self._sent.pop",
        "for name in needed:\n            self._sent.pop",
        (TEST_DISPATCH,),
    ),
    Change(
        "parcels of a second sending have the keys of the first",
        DISPATCH,
        "self._sendings += 1",
        "self._sendings += 0",
        (TEST_DISPATCH,),
    ),
    Change("two orders of a cell have one key", DISPATCH, "self._orders += 1", "self._orders += 0", (TEST_DISPATCH,)),
    Change("the longest way comes last", DISPATCH, "priority=priority,", "priority=-priority,", (TEST_DISPATCH,)),
    Change(
        "any worker may compute it",
        DISPATCH,
        "workers=None if only is None else sorted(only)",
        "workers=None",
        (TEST_DISPATCH,),
    ),
    Change("what failed is not told", DISPATCH, '"failed": sorted(failed)', '"failed": []', (TEST_DISPATCH,)),
    Change(
        "errors are swallowed",
        DISPATCH,
        "            if self.client.status == RUNNING:\n                raise",
        "            return",
        (TEST_DISPATCH,),
    ),
    Change(
        "a closed connection is waited for",
        DISPATCH,
        'if self.client.status not in (RUNNING, "connecting"):',
        'if self.client.status == "":',
        (TEST_DISPATCH,),
    ),
    Change(
        "workers of a connection that is being made",
        DISPATCH,
        "return found if self.client.status == RUNNING else {}",
        "return found",
        (TEST_DISPATCH,),
    ),
    Change(
        "a worker is asked for again and again",
        DISPATCH,
        'and (self._hello is None or self._hello.status != "pending")',
        "",
        (TEST_DISPATCH,),
    ),
    Change(
        "hidden files go along",
        DISPATCH,
        'if file.is_file() and not file.name.startswith(".")',
        "if file.is_file()",
        (TEST_DISPATCH,),
    ),
    Change(
        "runs of other data share processes",
        DISPATCH,
        "*map(digest_of, self._made_of.values())]",
        "]",
        (TEST_DISPATCH,),
    ),
    Change("nothing is cancelled in the end", DISPATCH, "self.client.cancel(list(futures))", "pass", (TEST_DISPATCH,)),
    Change(
        "sent parcels are kept in the end",
        DISPATCH,
        "                self.client.unsubscribe_topic(self._topic)\n        self._sent.clear()",
        "                self.client.unsubscribe_topic(self._topic)",
        (TEST_DISPATCH,),
    ),
    Change(
        "what is lost is believed to be there",
        DISPATCH,
        'and self._sent[name].status == "finished"',
        "",
        (TEST_DISPATCH,),
    ),
    Change(
        "a result that failed goes along",
        DISPATCH,
        'if record and record.status == "done"}',
        "if record}",
        (TEST_DISPATCH,),
    ),
    Change(
        "files of settings stand in one place",
        DISPATCH,
        'names[text] = f"{number}/{Path(text).name}"',
        "names[text] = Path(text).name",
        (TEST_DISPATCH,),
    ),
    Change("nobody waits and it is waited for", REMOTE, "if not wanted():", "if wanted is None:", (TEST_REMOTE,)),
    Change(
        "a process is taken twice", REMOTE, "child, timer = waiting.pop()", "child, timer = waiting[-1]", (TEST_REMOTE,)
    ),
    Change(
        "the time of an idle process goes on while it works", REMOTE, "            timer.cancel()\n", "", (TEST_REMOTE,)
    ),
    Change(
        "warnings are lost",
        REMOTE,
        'elif "remark" in message or "warning" in message:',
        'elif "remark" in message:',
        (TEST_REMOTE,),
    ),
    Change(
        "a cell that failed is blocked",
        REMOTE,
        "if record is None:\n            return {",
        "if record is not None:\n            return {",
        (TEST_REMOTE,),
    ),
    Change("the folder stays", REMOTE, "shutil.rmtree(self.folder, ignore_errors=True)", "pass", (TEST_REMOTE,)),
    Change("seconds of a failure are lost", REMOTE, '"seconds": record.seconds,', '"seconds": 0.0,', (TEST_REMOTE,)),
    Change(
        "a cell on a worker believes that others compute beside it", REMOTE, "alone=True", "alone=False", (TEST_REMOTE,)
    ),
    Change(
        "the end of a stopped process has no reason",
        REMOTE,
        '"reason": message["stop"][1]',
        '"reason": message["stop"][0]',
        (TEST_REMOTE,),
    ),
    Change(
        "a client that is asynchronous is taken",
        SCHEDULER,
        "if scheduler.asynchronous:",
        "if not scheduler:",
        (TEST_SCHEDULER,),
    ),
    Change(
        "what a client logs is lost after a scheduler was", SCHEDULER, "log.setLevel(level)", "pass", (TEST_SCHEDULER,)
    ),
    Change(
        "a lost scheduler is logged and told", SCHEDULER, "log.setLevel(logging.CRITICAL)", "pass", (TEST_SCHEDULER,)
    ),
    Change(
        "a file without an address breaks the command",
        SCHEDULER,
        "(OSError, ValueError, TypeError, KeyError, RecursionError)",
        "(OSError, ValueError, TypeError, RecursionError)",
        (TEST_SCHEDULER,),
    ),
    Change(
        "a file that is no table breaks the command",
        SCHEDULER,
        "(OSError, ValueError, TypeError, KeyError, RecursionError)",
        "(OSError, ValueError, KeyError, RecursionError)",
        (TEST_SCHEDULER,),
    ),
    Change(
        "the default client is changed", SCHEDULER, "set_as_default=False", "set_as_default=True", (TEST_SCHEDULER,)
    ),
    Change("no client is closed", SCHEDULER, "            client.close()", "            pass", (TEST_SCHEDULER,)),
    Change(
        "times of files are not told apart",
        PARCELS,
        'f"{name}\\0{changed}\\0{len(content)}\\0"',
        'f"{name}\\0{len(content)}\\0"',
        (TEST_PARCELS,),
    ),
    Change(
        "files that run together are not told apart",
        PARCELS,
        'f"{name}\\0{changed}\\0{len(content)}\\0"',
        'f"{name}{changed}"',
        (TEST_PARCELS,),
    ),
    Change(
        "files are as old as they are here", PARCELS, "os.utime(file, ns=(changed, changed))", "pass", (TEST_PARCELS,)
    ),
    Change(
        "an absolute path is inside",
        PARCELS,
        'return not path.is_absolute() and ".." not in path.parts',
        'return ".." not in path.parts',
        (TEST_PARCELS,),
    ),
    Change(
        "one worker that died is two",
        CLUSTER,
        "times = error.allowed_failures + 1",
        "times = error.allowed_failures + 2",
        (TEST_WHAT_IS_LOST,),
    ),
    Change(
        "a cell at which workers die goes round for ever",
        CLUSTER,
        "if isinstance(error, KilledWorker):",
        "if isinstance(error, KeyboardInterrupt):",
        (TEST_WHAT_IS_LOST,),
    ),
    Change(
        "what workers cannot run is sent again",
        CLUSTER,
        "            self.home.add(cell.digest)\n",
        "",
        (TEST_WHAT_IS_LOST,),
    ),
    Change(
        "what is lost is sent for ever",
        CLUSTER,
        "if self.lost[cell.digest] > LOST:",
        "if self.lost[cell.digest] > 1000 * LOST:",
        (TEST_WHAT_IS_LOST,),
    ),
    Change(
        "lost data are believed to be there",
        CLUSTER,
        "            self.post.mistrust({needed.digest for needed in cell.needs})\n",
        "",
        (TEST_WHAT_IS_LOST,),
    ),
    Change("a new scheduler is not listened to", CLUSTER, "            self.post.listen()\n", "", (TEST_WHAT_IS_LOST,)),
    Change(
        "a process that ended is no try",
        CLUSTER,
        "if self.tried[cell.digest] >= TRIES:",
        "if self.tried[cell.digest] > TRIES:",
        (TEST_WHAT_IS_LOST,),
    ),
    Change(
        "a result that is not whole stops the run",
        CLUSTER,
        "            except ArtefactError as error:\n                self._try_again",
        "            except KeyError as error:\n                self._try_again",
        (TEST_WHAT_IS_LOST,),
    ),
    Change(
        "what failed elsewhere took no time",
        CLUSTER,
        'answer["traceback"] or "", answer["seconds"])',
        'answer["traceback"] or "", 0.0)',
        (TEST_WHAT_IS_LOST,),
    ),
    Change(
        "what a worker cannot plan is believed to be all",
        CLUSTER,
        'unknown = frozenset(asked - set(answer["knows"]) | {cell.digest})',
        "unknown = frozenset(asked)",
        (TEST_WHAT_IS_LOST,),
    ),
    Change(
        "equal versions are told as other ones",
        CLUSTER,
        "if version != ours.get(name)}",
        "if version}",
        (TEST_WHAT_IS_LOST,),
    ),
    Change(
        "every worker tells what it cannot plan", CLUSTER, "            self.told.add(told)\n", "", (TEST_WHAT_IS_LOST,)
    ),
    Change(
        "a cell goes to workers that cannot plan it",
        CLUSTER,
        "only = able if len(able) < len(self.workers) else None",
        "only = None",
        (TEST_WHAT_IS_LOST,),
    ),
    Change(
        "results of failed cells are sent",
        CLUSTER,
        "needs = {needed.digest for needed in cell.needs} - failed",
        "needs = {needed.digest for needed in cell.needs}",
        (TEST_WHAT_IS_LOST,),
    ),
    Change(
        "a cell that nobody took stays claimed",
        CLUSTER,
        "+ LOOK\n                return\n",
        "+ LOOK\n                self.kept = claim.pop_all()\n                return\n",
        (TEST_WHAT_IS_LOST,),
    ),
    Change(
        "nothing is handed out ahead",
        CLUSTER,
        "room = FIRST + AHEAD * sum(self.workers.values())",
        "room = FIRST + sum(self.workers.values())",
        (TEST_WHAT_IS_LOST,),
    ),
    Change("what is away leaves no less room", CLUSTER, " - len(self.away)\n", "\n", (TEST_WHAT_IS_LOST,)),
    Change(
        "what needs a cell that stays here is sent",
        "sysid_evo/plan/plan.py",
        "if cell.at_home or any(needed.digest in found for needed in cell.needs):",
        "if cell.at_home:",
        (TEST_WHAT_IS_LOST,),
    ),
    Change(
        "without workers nothing is sent",
        CLUSTER,
        "or bool(self.workers and not there)",
        "or not there",
        (TEST_WHAT_IS_LOST,),
    ),
)
