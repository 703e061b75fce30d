#!/usr/bin/env python3
"""deploy/cluster: the manifests fit a schema and each other, HAProxy's file is one, and its health check asks what it says."""
import os
import re
import shutil
import subprocess
import tempfile
import unittest

try:
    import yaml
except ImportError:
    yaml = None

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))
CLUSTER = os.path.join(ROOT, "deploy", "cluster")

# Of what the manifests use of Kubernetes 1.23 and later: type, or a dictionary of keys ("!": required), or a list of one.
LABELS = {str: str}
SELECTOR = {"matchLabels!": LABELS}
PEER = {"podSelector": SELECTOR}
PORTS = [{"protocol!": str, "port!": int}]
PROBE = {"tcpSocket!": {"port!": str}, "periodSeconds!": int, "failureThreshold!": int}
POD = {
    "terminationGracePeriodSeconds!": int, "automountServiceAccountToken!": bool,
    "securityContext!": {"runAsNonRoot!": bool, "runAsUser!": int, "seccompProfile": {"type!": str}},
    "topologySpreadConstraints": [{"maxSkew!": int, "topologyKey!": str, "whenUnsatisfiable!": str, "labelSelector!": SELECTOR}],
    "containers!": [{
        "name!": str, "image!": str, "command": [str], "args": [str], "ports": [{"name!": str, "containerPort!": int}],
        "resources!": {"requests!": {str: str}, "limits!": {str: str}},
        "startupProbe": PROBE, "readinessProbe!": PROBE, "livenessProbe!": PROBE,
        "lifecycle": {"preStop": {"exec!": {"command!": [str]}}},
        "securityContext!": {"allowPrivilegeEscalation!": bool, "readOnlyRootFilesystem!": bool, "capabilities!": {"drop!": [str]}},
        "volumeMounts": [{"name!": str, "mountPath!": str, "readOnly": bool}]}],
    "volumes": [{"name!": str, "emptyDir": {"sizeLimit": str}, "secret": {"secretName!": str, "defaultMode": int}}]}
SPECS = {
    ("apps/v1", "Deployment"): {
        "replicas!": int, "selector!": SELECTOR,
        "strategy": {"type!": str, "rollingUpdate": {"maxUnavailable": int, "maxSurge": int}},
        "template!": {"metadata!": {"labels!": LABELS}, "spec!": POD}},
    ("v1", "Service"): {"clusterIP": str, "selector!": LABELS, "ports!": [{"name!": str, "port!": int, "targetPort!": str}]},
    ("policy/v1", "PodDisruptionBudget"): {"minAvailable!": int, "selector!": SELECTOR},
    ("autoscaling/v2", "HorizontalPodAutoscaler"): {
        "scaleTargetRef!": {"apiVersion!": str, "kind!": str, "name!": str}, "minReplicas!": int, "maxReplicas!": int,
        "metrics!": [{"type!": str, "pods": {"metric!": {"name!": str}, "target!": {"type!": str, "averageValue!": str}}}],
        "behavior": {"scaleDown": {"stabilizationWindowSeconds": int}}},
    ("networking.k8s.io/v1", "NetworkPolicy"): {
        "podSelector!": SELECTOR, "policyTypes!": [str], "ingress": [{"from": [PEER], "ports": PORTS}],
        "egress": [{"to": [PEER], "ports": PORTS}]},
}


def violations(value, schema, where):
    if isinstance(schema, type):
        right = isinstance(value, schema) and not (schema is int and isinstance(value, bool))
        return [] if right else ["%s: %r is no %s" % (where, value, schema.__name__)]
    if isinstance(schema, list):
        if not isinstance(value, list) or not value:
            return [where + ": no list of at least one"]
        return [v for i, one in enumerate(value) for v in violations(one, schema[0], "%s[%d]" % (where, i))]
    if not isinstance(value, dict):
        return [where + ": no mapping"]
    if str in schema:
        return [v for k, one in value.items() for v in violations(one, schema[str], "%s.%s" % (where, k))]
    known = {k.rstrip("!"): s for k, s in schema.items()}
    found = ["%s.%s: unknown" % (where, k) for k in value if k not in known]
    found += ["%s.%s: missing" % (where, k[:-1]) for k in schema if k.endswith("!") and k[:-1] not in value]
    return found + [v for k, one in value.items() if k in known for v in violations(one, known[k], "%s.%s" % (where, k))]


def check(document):
    kind = (document.get("apiVersion"), document.get("kind"))
    if kind not in SPECS:
        return ["%s %s: not a kind that is used here" % kind]
    schema = {"apiVersion!": str, "kind!": str, "metadata!": {"name!": str, "labels": LABELS}, "spec!": SPECS[kind]}
    return violations(document, schema, kind[1])


@unittest.skipIf(yaml is None, "python3-yaml is not installed")
class Manifests(unittest.TestCase):

    def setUp(self):
        with open(os.path.join(CLUSTER, "kubernetes", "replicas.yaml"), encoding="utf-8") as file:
            self.documents = list(yaml.safe_load_all(file))
        self.by_kind = {d["kind"]: d for d in self.documents}

    def test_they_fit_the_schema(self):
        self.assertEqual([v for d in self.documents for v in check(d)], [])
        self.assertEqual(set(self.by_kind), {kind for _, kind in SPECS})

    def test_the_schema_finds_what_is_wrong(self):
        deployment = self.by_kind["Deployment"]
        pod = deployment["spec"]["template"]["spec"]
        for change in (lambda: deployment["spec"].update(replicas="3"), lambda: pod.update(volume=[]),
                       lambda: pod["containers"][0].pop("image"), lambda: pod.update(containers=[])):
            change()
            self.assertNotEqual(check(deployment), [])
            self.setUp()
            deployment = self.by_kind["Deployment"]
            pod = deployment["spec"]["template"]["spec"]
        self.assertNotEqual(check({"apiVersion": "v1", "kind": "Deployment"}), [])

    def test_they_fit_each_other(self):
        deployment = self.by_kind["Deployment"]["spec"]
        labels = deployment["template"]["metadata"]["labels"]
        for selector in (deployment["selector"]["matchLabels"], self.by_kind["Service"]["spec"]["selector"],
                         self.by_kind["PodDisruptionBudget"]["spec"]["selector"]["matchLabels"],
                         self.by_kind["NetworkPolicy"]["spec"]["podSelector"]["matchLabels"]):
            self.assertLessEqual(selector.items(), labels.items())
        self.assertLess(self.by_kind["PodDisruptionBudget"]["spec"]["minAvailable"], deployment["replicas"])
        scaler = self.by_kind["HorizontalPodAutoscaler"]["spec"]
        self.assertEqual(scaler["scaleTargetRef"]["name"], self.by_kind["Deployment"]["metadata"]["name"])
        self.assertEqual(scaler["minReplicas"], deployment["replicas"])
        pod = deployment["template"]["spec"]
        container = pod["containers"][0]
        ports = {p["name"] for p in container["ports"]}
        for probe in ("startupProbe", "readinessProbe", "livenessProbe"):
            self.assertIn(container[probe]["tcpSocket"]["port"], ports)
        self.assertEqual({m["name"] for m in container["volumeMounts"]}, {v["name"] for v in pod["volumes"]})
        options = dict(a.lstrip("-").split("=", 1) for a in container["args"])
        with open(os.path.join(ROOT, "server", "flags.cc"), encoding="utf-8") as file:
            known = file.read()
        for option in options:
            self.assertIn('"--%s"' % option, known)
        # What runs is finished, and preStop has passed, before Kubernetes kills.
        self.assertGreater(pod["terminationGracePeriodSeconds"],
                           float(options["drain-seconds"]) + float(container["lifecycle"]["preStop"]["exec"]["command"][1]))
        with open(os.path.join(ROOT, "server", "service", "live_figures.cc"), encoding="utf-8") as file:
            self.assertIn('"%s"' % scaler["metrics"][0]["pods"]["metric"]["name"], file.read())


@unittest.skipIf(yaml is None, "python3-yaml is not installed")
class RankerManifests(unittest.TestCase):

    def setUp(self):
        with open(os.path.join(CLUSTER, "kubernetes", "rankers.yaml"), encoding="utf-8") as file:
            self.documents = list(yaml.safe_load_all(file))

    def test_they_fit_the_schema(self):
        self.assertEqual([v for d in self.documents for v in check(d)], [])

    def test_each_shard_is_there_once_and_has_its_service(self):
        deployments = [d for d in self.documents if d["kind"] == "Deployment"]
        services = {d["metadata"]["name"]: d["spec"]["selector"] for d in self.documents if d["kind"] == "Service"}
        with open(os.path.join(ROOT, "server", "flags.cc"), encoding="utf-8") as file:
            known = file.read()
        shards = []
        for deployment in deployments:
            template = deployment["spec"]["template"]
            container = template["spec"]["containers"][0]
            options = dict(a.lstrip("-").split("=", 1) for a in container["args"])
            for option in options:
                self.assertIn('"--%s"' % option, known)
            self.assertEqual(options["role"], "ranker")
            shards.append(options["shard"])
            name = deployment["metadata"]["name"]
            self.assertEqual(services[name], template["metadata"]["labels"])
            self.assertEqual(services[name], deployment["spec"]["selector"]["matchLabels"])
            self.assertEqual({m["name"] for m in container["volumeMounts"]}, {v["name"] for v in template["spec"]["volumes"]})
        self.assertEqual(shards, ["%d/%d" % (i + 1, len(deployments)) for i in range(len(deployments))])


class Balancer(unittest.TestCase):

    def setUp(self):
        with open(os.path.join(CLUSTER, "haproxy.cfg"), encoding="utf-8") as file:
            self.text = file.read()

    def test_nginx_takes_its_file(self):
        nginx = shutil.which("nginx") or "/usr/sbin/nginx"
        if not os.access(nginx, os.X_OK):
            self.skipTest("nginx is not installed")
        with tempfile.TemporaryDirectory() as folder:
            done = subprocess.run([nginx, "-t", "-e", folder + "/log", "-p", folder, "-c", os.path.join(CLUSTER, "nginx.conf"), "-g",
                                   "pid %s/pid;" % folder], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
        self.assertEqual(done.returncode, 0, done.stdout)

    def test_its_health_check_asks_for_health(self):
        sent = [bytes.fromhex(h) for h in re.findall(r"send-binary ([0-9a-f]+)", self.text)]
        self.assertEqual(len(sent), 6)
        self.assertEqual(sent[:3], sent[3:])
        preface, headers, data = sent[:3]
        self.assertTrue(preface.startswith(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"))
        for part in (b"/grpc.health.v1.Health/Check", b"application/grpc", b"trailers"):
            self.assertIn(bytes([len(part)]) + part, headers)
        self.assertEqual(int.from_bytes(headers[:3], "big"), len(headers) - 9)
        self.assertEqual(data[9:], bytes(5))  # an empty message

    def test_calls_that_may_have_arrived_are_not_repeated(self):
        self.assertEqual(re.findall(r"retry-on (.*)", self.text), ["conn-failure"])

    def test_haproxy_takes_it(self):
        program = shutil.which("haproxy") or "/usr/sbin/haproxy"
        if not os.access(program, os.X_OK):
            self.skipTest("haproxy is not installed")
        names = set(re.findall(r"\$\{(\w+)\}", self.text))
        with tempfile.TemporaryDirectory() as folder:
            values = {"HOROPTER_WORKERS": "1", "HOROPTER_QUEUE": "8", "HOROPTER_SOCKET": os.path.join(folder, "haproxy.sock")}
            environment = dict(os.environ, **{n: values.get(n, "127.0.0.1:1") for n in names})
            done = subprocess.run([program, "-c", "-f", os.path.join(CLUSTER, "haproxy.cfg")], env=environment,
                                  capture_output=True, text=True, check=False)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertNotIn("WARNING", done.stderr)


if __name__ == "__main__":
    unittest.main()
