"""Clone a dataset on several GPUs of one machine, or on processors, by torchrun.

    trocar learn collect needle-pick --episodes 2000 --workers 16 -o data
    torchrun --nproc-per-node 4 examples/learning/clone_on_gpus.py needle-pick data pick.toml

Each process has every n-th period and averages gradients with the others; the first writes the
policy for `trocar play needle-pick --policy pick.toml`. A batch has 512 periods of each process.
"""

import argparse
import os
from itertools import pairwise

import numpy as np
import torch
import torch.distributed as group
from torch import nn

from trocar.learning.cloning import CloneSettings, ensemble, read_demonstrations
from trocar.learning.features import SceneFeatures
from trocar.learning.networks import make_perceptron
from trocar.learning.policies import TrainedPolicy, save_policy
from trocar.tasks import make_task

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("scene")
parser.add_argument("data", help="folder of trocar learn collect")
parser.add_argument("output", help="NAME.toml")
parser.add_argument("--steps", type=int, default=6000)
args = parser.parse_args()

cuda = torch.cuda.is_available()
group.init_process_group("nccl" if cuda else "gloo")
rank, count = group.get_rank(), group.get_world_size()
device = f"cuda:{os.environ['LOCAL_RANK']}" if cuda else "cpu"
torch.manual_seed(rank)

task, settings = make_task(args.scene), CloneSettings()
shown = read_demonstrations(args.data, task, settings)  # every process reads all of it


def normalised(values):
    """Return values in standard deviations from the mean, and both."""
    mean, std = values.mean(0), values.std(0) + np.float32(1e-2)
    return torch.from_numpy(((values - mean) / std)[rank::count]).to(device), (mean, std)


(x, inputs), (y, outputs) = normalised(shown.inputs), normalised(shown.plans)
sizes = [x.shape[1], *[settings.width] * settings.hidden, y.shape[1]]
layers = [nn.Linear(a, b) for a, b in pairwise(sizes)]
stack = [module for layer in layers for module in (layer, nn.GELU())][:-1]
net = nn.parallel.DistributedDataParallel(
    nn.Sequential(*stack).to(device), [int(os.environ["LOCAL_RANK"])] if cuda else None
)
adam = torch.optim.AdamW(net.parameters(), weight_decay=1e-3)
cycle = torch.optim.lr_scheduler.OneCycleLR(adam, settings.rate, total_steps=args.steps + 1)
for step in range(args.steps):
    rows = torch.randint(len(x), (settings.batch,), device=device)
    noisy = x[rows] + settings.noise * torch.randn(settings.batch, x.shape[1], device=device)
    loss = nn.functional.smooth_l1_loss(net(noisy), y[rows])
    adam.zero_grad()
    loss.backward()
    adam.step()
    cycle.step()
    if rank == 0 and step % 500 == 0:
        print(f"step {step}: loss {loss.item():.4f}", flush=True)
if rank == 0:
    weights = [
        (one.weight.detach().cpu().numpy(), one.bias.detach().cpu().numpy()) for one in layers
    ]
    network = make_perceptron(weights, "gelu", inputs=inputs, outputs=outputs)
    names = SceneFeatures(task).names
    policy = TrainedPolicy(
        "clone", task.scene.name, network, features=names, ensemble=ensemble(settings)
    )
    save_policy(args.output, policy)
group.destroy_process_group()
