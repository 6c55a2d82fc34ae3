"""Variants of the uncertainty, by group and by name, for each method that has some."""

import pytest
from uncle.recon.core.config.map_config import make_config
from uncle.recon.core.errors import ConfigError
from uncle.recon.evaluation.bench.variants import GROUPS, METHOD_OF, UNWEIGHTED, choose_variants, variants_of_methods


def test_every_variant_is_made_of_settings_of_its_method():
    variants = variants_of_methods(list(GROUPS))
    assert {variant.method for variant in variants} == {"uncle", *METHOD_OF.values()}
    configs = {(v.method, v.name): make_config(v.method, list(v.settings)) for v in variants}
    assert len(configs) == len(variants) == sum(map(len, GROUPS.values())) + len({v.method for v in variants})
    assert set(METHOD_OF) <= set(GROUPS)


def test_each_method_has_its_unweighted_one_first():
    names = [variant.name for variant in variants_of_methods(["1K2FS", "uncle"])]
    assert names == [UNWEIGHTED, "1K2FS", "uncle"]
    assert variants_of_methods([]) == []
    assert [variant.name for variant in variants_of_methods([UNWEIGHTED])] == [UNWEIGHTED]
    assert list(choose_variants([])) == [UNWEIGHTED]


def test_variants_of_another_method_are_not_mistaken_for_ours():
    for name in ("uncle-paper", "h_w 5K2FS"):
        with pytest.raises(ConfigError, match="another method"):
            choose_variants([name])
    assert {variant.method for variant in variants_of_methods(["h_w 5K2FS", "uncle"])} == {"uncle", "uncle-paper"}


def test_names_are_of_one_group_only():
    names = [name for variants in GROUPS.values() for name in variants]
    assert len(set(names)) == len(names)
    assert not set(names) & set(GROUPS)
    with pytest.raises(ConfigError, match="'6K2FS'; there are paper, uncle-paper, own"):
        variants_of_methods(["6K2FS"])
